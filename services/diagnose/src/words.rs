//! Findings in the words of a controls engineer.

use crate::findings::{Finding, Findings, Parameter};

/// Joints as a reader would list them.
fn joints(names: &[String]) -> String {
    match names {
        [] => "The robot".to_owned(),
        [one] => format!("Joint {one}"),
        [head @ .., last] => format!("Joints {} and {last}", head.join(", ")),
    }
}

fn value(f: &Finding, symbol: &str) -> Option<String> {
    f.parameters.iter().find(|p| p.symbol == symbol).map(number)
}

/// A value with its interval and unit.
fn number(p: &Parameter) -> String {
    let half = 0.5 * (p.ci95[1] - p.ci95[0]);
    if half > 0.0 && half.is_finite() {
        format!("{} ± {} {}", digits(p.value), digits(half), p.unit)
    } else {
        format!("{} {}", digits(p.value), p.unit)
    }
}

/// Three significant digits.
fn digits(v: f64) -> String {
    if v == 0.0 || !v.is_finite() {
        return format!("{v}");
    }
    let places = (2 - v.abs().log10().floor() as i32).clamp(0, 6) as usize;
    format!("{v:.places$}")
}

/// The sentence of a finding.
pub fn sentence(f: &Finding, unit: &str) -> String {
    let who = joints(&f.joints);
    let one = f.joints.len() < 2;
    let s = |single: &'static str, many: &'static str| if one { single } else { many };
    let v = |symbol: &str| value(f, symbol).unwrap_or_default();
    let what = match f.effect.as_str() {
        "coulomb_asym" | "torque_offset" => format!(
            "{who} {} a constant torque more than the model ({}): unequal Coulomb levels or a sensor offset, the same while sliding",
            s("needs", "need"),
            v("a_c")
        ),
        "stribeck" => format!(
            "{who} {} before {}: friction rises by {} towards standstill, below about {}",
            s("sticks", "stick"),
            s("it slides", "they slide"),
            v("f_sc"),
            v("v_s")
        ),
        "viscous_power" => format!("{who}: drag does not grow in proportion to speed but with its power {}", v("p")),
        "load_friction" => format!(
            "{who}: friction grows with the load, by {} of the link torque",
            value(f, "mu").unwrap_or_else(|| v("mu_v"))
        ),
        "thermal_viscous" => format!(
            "{who}: viscous friction falls as the drive warms up ({})",
            value(f, "b").unwrap_or_else(|| v("b_T"))
        ),
        "presliding" => format!("{who}: after a reversal friction builds up over {} instead of jumping", v("delta")),
        "backlash" => format!("{who} {} play: a half gap of {} behind the encoder", s("has", "have"), v("b")),
        "cogging" => {
            let orders: Vec<String> =
                f.parameters.iter().filter(|p| p.symbol == "h").map(|p| digits(p.value)).collect();
            format!("{who}: torque ripples with the motor's turns, at order {} per revolution", orders.join(", "))
        }
        "elasticity" => format!("{who} {} soft: {} between motor and link", s("is", "are"), v("k")),
        "rotor_inertia" => format!(
            "{who} {} more inertia than the model by {}: rotor or arm, not separable from these signals",
            s("carries", "carry"),
            v("J")
        ),
        "arm_inertia" => format!(
            "{who}: the arm's inertia and centre of mass differ from the model (I {}, m_1 {})",
            v("I"),
            v("m_1")
        ),
        "gravity_spring" => format!(
            "{who}: a torque like a counterbalance or a shifted centre of mass (sin {}, cos {})",
            v("a_s"),
            v("a_c")
        ),
        "cable_spring" => format!(
            "{who}: something pulls back like a spring, stiffer the further it goes (k_1 {}, k_3 {})",
            v("k_1"),
            v("k_3")
        ),
        "axis_coupling" => format!(
            "{who}: the second joint's motor is felt on the first (inertia {}, viscous {}, Coulomb {})",
            v("J"),
            v("f_v"),
            v("f_c")
        ),
        "forearm_rod" => {
            format!("The forearms are rods, not points at their ends (Δs_1 {}, Δs_2 {})", v("ds_1"), v("ds_2"))
        }
        "kt_scale" => format!("{who}: the drive's torque constant is off; it reports {} too much", v("g")),
        "base_tilt" => format!("The base is tilted by {} and {}", v("tilt_1"), v("tilt_2")),
        "encoder_offset" => format!("{who} {} homed {} off", s("was", "were"), v("q_0")),
        "link_length" => format!("{who}: the link's length is off by {}", value(f, "dl").unwrap_or_else(|| v("dl_2"))),
        "payload" if f.intervals_s.is_empty() => {
            format!("The robot carries {} more than the model at platform or tip", v("m"))
        }
        "payload" => format!("The robot carries {} from time to time ({} carries)", v("m"), f.intervals_s.len()),
        "payload_ecc" => format!(
            "The payload sits off the axis of the wrist, which swings it round at {} (moments {}, {} in the first carry)",
            v("omega"),
            v("m_x"),
            v("m_y")
        ),
        "torque_delay" => format!("The torque signal is late by {} against the position", v("D")),
        "torque_saturation" => format!("{who}: above {} the drive reports more torque than it gives", v("tau_k")),
        "air_drag" => format!("Air drag at platform or tip, {}", v("c")),
        "ball_friction" => format!("The ball joints rub: {} at each centre", value(f, "mu").unwrap_or_else(|| v("b"))),
        "collision" => format!("The robot touched something {} time(s)", f.intervals_s.len()),
        _ => format!("{who}: a torque that no effect of the catalogue explains"),
    };
    format!(
        "{what}; on recordings it was not fitted to, the residual there falls from {} to {} {unit} ({:.0} % less).",
        digits(f.held_out.before_rms_nm),
        digits(f.held_out.after_rms_nm),
        100.0 * f.held_out.reduction
    )
}

/// The verdict of all findings.
pub fn verdict(f: &Findings) -> String {
    let left = format!("Relative error on held-out recordings {:.1} %", 100.0 * f.held_out.relative_after);
    match f.findings.as_slice() {
        [] => format!(
            "The model with viscous and Coulomb friction is complete within noise and the robot file's tolerances. {left}."
        ),
        [one] => format!("{} {left} (before: {:.1} %).", one.sentence, 100.0 * f.held_out.relative_before),
        [first, rest @ ..] => {
            let names: Vec<String> = rest
                .iter()
                .map(|r| {
                    format!(
                        "{}{}",
                        r.effect,
                        if r.joints.is_empty() { String::new() } else { format!(" ({})", r.joints.join(", ")) }
                    )
                })
                .collect();
            format!(
                "{} Also: {}; {left} (before: {:.1} %).",
                first.sentence,
                names.join("; "),
                100.0 * f.held_out.relative_before
            )
        }
    }
}
