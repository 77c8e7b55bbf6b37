//! Findings in the words of a controls engineer.
//!
//! One form throughout: what the joint does, where and how much torque the model misses there, and what the term that
//! was found removes of it on data it had not seen.

use crate::findings::{Finding, Findings, Parameter, Reduction, Region};
use lacuna_physics::effects;

/// What all sentences of one diagnosis share.
pub struct Words<'a> {
    /// Unit of the torque.
    pub unit: &'a str,
    /// How rows were held out.
    pub split: &'a str,
    /// Whether the model is the user's own simulator.
    pub against: bool,
}

/// Joints as a reader would list them.
fn joints(names: &[String]) -> String {
    match names {
        [] => "The robot".to_owned(),
        // Joints that are called so need not be called so twice.
        [one] if called(one) => one.clone(),
        [one] => format!("Joint {one}"),
        [head @ .., last] if called(last) => format!("{} and {last}", head.join(", ")),
        [head @ .., last] => format!("Joints {} and {last}", head.join(", ")),
    }
}

/// Whether a joint's name says that it is one.
fn called(name: &str) -> bool {
    name.to_lowercase().contains("joint")
}

/// Three significant digits.
pub(crate) fn digits(v: f64) -> String {
    if v == 0.0 || !v.is_finite() {
        return format!("{v}");
    }
    let places = (2 - v.abs().log10().floor() as i32).clamp(0, 6) as usize;
    format!("{v:.places$}")
}

/// As many digits as the uncertainty leaves: two of it, but no more than four of the value.
fn rounded(v: f64, half: f64) -> (String, String) {
    let last = |x: f64, digits: i32| digits - 1 - x.abs().max(1e-12).log10().floor() as i32;
    let places = last(half, 2).min(last(v, 4).max(last(half, 1).min(last(v, 5)))).clamp(0, 9) as usize;
    let short =
        if half < 0.5 * 10f64.powi(-(places as i32)) { format!("{half:.0e}") } else { format!("{half:.places$}") };
    (format!("{v:.places$}"), short)
}

/// A value with its interval and unit.
fn number(p: &Parameter) -> String {
    let half = 0.5 * (p.ci95[1] - p.ci95[0]);
    let unit = if p.unit.is_empty() || p.unit == "1" { String::new() } else { format!(" {}", p.unit) };
    if half > 0.0 && half.is_finite() {
        let (value, half) = rounded(p.value, half);
        format!("{value} ± {half}{unit}")
    } else {
        format!("{}{unit}", digits(p.value))
    }
}

/// The parameters `symbols` in words: of one joint with interval, of several as a range.
fn values(f: &Finding, symbols: &[&str]) -> String {
    let one = |symbol: &&str| {
        let list: Vec<&Parameter> = f.parameters.iter().filter(|p| p.symbol == *symbol).collect();
        match list.as_slice() {
            [] => None,
            [p] => Some(format!("{symbol} = {}", number(p))),
            several => {
                let low = several.iter().map(|p| p.value).fold(f64::INFINITY, f64::min);
                let high = several.iter().map(|p| p.value).fold(f64::NEG_INFINITY, f64::max);
                Some(
                    format!("{symbol} = {} to {} {}", digits(low), digits(high), several[0].unit).trim_end().to_owned(),
                )
            }
        }
    };
    let words: Vec<String> = symbols.iter().filter_map(one).collect();
    if words.is_empty() { String::new() } else { format!(" ({})", words.join(", ")) }
}

/// Where in the motion, as the beginning of a clause.
fn place(region: &Region) -> String {
    let (low, high) = (digits(region.low), digits(region.high));
    match region.variable.as_str() {
        "qd_rad_s" if (region.low + region.high).abs() < 1e-9 * region.high.abs() => format!("below {high} rad/s"),
        "qd_rad_s" => format!("between {low} and {high} rad/s"),
        "q_rad" => format!("at angles from {low} to {high} rad"),
        "qdd_rad_s2" => format!("at accelerations from {low} to {high} rad/s²"),
        "load_nm" => format!("under loads from {low} to {high} Nm"),
        "since_reversal_rad" if region.low <= 0.0 => format!("within {high} rad of a reversal"),
        "since_reversal_rad" => format!("{low} to {high} rad after a reversal"),
        "temperature_degc" => format!("from {low} to {high} °C"),
        "order_per_rev" => format!("at orders {low} to {high} per motor revolution"),
        other => format!("at {other} from {low} to {high}"),
    }
}

/// What is the matter, and the term that describes it.
fn story(f: &Finding) -> (String, String) {
    let who = joints(&f.joints);
    let many = f.joints.len() > 1;
    let s = |single: &str, plural: &str| (if many { plural } else { single }).to_owned();
    let v = |symbols: &[&str]| values(f, symbols);
    let has = |symbol: &str| f.parameters.iter().any(|p| p.symbol == symbol);
    match f.effect.as_str() {
        "coulomb" => (
            format!("{who} {} other dry friction", s("has", "have")),
            format!("a Coulomb term beyond the simulator's{}", v(&["f_c"])),
        ),
        "viscous" => (
            format!("{who} {} other drag", s("has", "have")),
            format!("a viscous term beyond the simulator's{}", v(&["f_v"])),
        ),
        "coulomb_asym" | "torque_offset" => (
            format!("{who} {} harder one way than the other", s("moves", "move")),
            format!("a constant torque, be it unequal Coulomb friction or a sensor offset{}", v(&["a_c"])),
        ),
        "stribeck" => (
            format!("{who} {} before {}", s("sticks", "stick"), s("it slides", "they slide")),
            format!("a Stribeck term{}", v(&["v_s", "f_sc"])),
        ),
        "viscous_power" => (
            format!("{who}: drag does not grow in proportion to speed"),
            format!("drag with a power of the speed{}", v(&["p", "a"])),
        ),
        "load_friction" => (
            format!("{who}: friction grows with the load"),
            format!("friction as a share of the link torque{}", v(&["mu", "mu_v"])),
        ),
        "thermal_viscous" => (
            format!("{who}: friction changes as the drive warms up"),
            format!(
                "friction that changes with {}{}",
                if has("b_T") || has("c_T") { "temperature" } else { "time" },
                { v(&["b", "b_T", "c_T", "tau_w"]) }
            ),
        ),
        "presliding" => (
            format!("{who}: after a reversal friction builds up over a distance, it does not jump"),
            format!("a presliding bristle{}", v(&["delta", "f"])),
        ),
        "backlash" => {
            (format!("{who} {} play behind the encoder", s("has", "have")), { format!("a gap{}", v(&["b", "k"])) })
        }
        "cogging" => (
            format!("{who}: torque ripples with the angle of the motor"),
            format!("a ripple by order per revolution{}", v(&["h", "a_s", "a_c"])),
        ),
        "elasticity" => (
            format!("{who} {} between motor and link", s("is soft", "are soft")),
            format!("a spring{}", v(&["k", "zeta"])),
        ),
        "rotor_inertia" => (
            format!("{who} {} more inertia than the model", s("carries", "carry")),
            format!("added inertia{}, of rotor or arm alike,", v(&["J"])),
        ),
        "arm_inertia" => (
            format!("{who}: inertia and centre of mass of the arm are not the model's"),
            format!("an arm with its own inertia and moment{}", v(&["I", "m_1", "m_2"])),
        ),
        "gravity_spring" => (
            format!("{who} {} a torque like a counterbalance or a shifted centre of mass", s("feels", "feel")),
            format!("a sine of the angle{}", v(&["a_s", "a_c"])),
        ),
        "cable_spring" => (
            format!("{who}: something pulls back, harder the further it goes"),
            format!("a stiffening spring{}", v(&["k_1", "k_3", "q_0"])),
        ),
        "axis_coupling" => (
            format!("{who}: the motor of the second is felt on the first"),
            format!("a coupling of both axes{}", v(&["J", "f_v", "f_c"])),
        ),
        "forearm_rod" => (
            "The forearms are rods, not points at their ends".to_owned(),
            format!("distributed mass{}", v(&["ds_1", "ds_2", "dm"])),
        ),
        "kt_scale" => (
            format!("{who}: the torque constant is not what the drive believes"),
            format!("a gain on the reported torque{}", v(&["g"])),
        ),
        "base_tilt" => ("The base is not level".to_owned(), format!("a tilt of gravity{}", v(&["tilt_1", "tilt_2"]))),
        "encoder_offset" => {
            (format!("{who} {} homed wrongly", s("was", "were")), format!("an offset of the encoder{}", v(&["q_0"])))
        }
        "link_length" => (
            format!("{who}: a link is not as long as the robot file says"),
            format!("another length{}", v(&["dl", "dl_2"])),
        ),
        "payload" if f.intervals_s.is_empty() => {
            ("The robot carries something all the time".to_owned(), format!("a mass at its tip{}", v(&["m"])))
        }
        "payload" => (
            format!("The robot picks something up and puts it down ({})", carries(f.intervals_s.len())),
            format!("a payload{}", v(&["m"])),
        ),
        "payload_ecc" => (
            "The payload sits off the axis of the wrist, which swings it round".to_owned(),
            format!("an eccentric payload{}", v(&["omega", "m_x", "m_y"])),
        ),
        "torque_delay" => {
            ("The torque signal is late against the position".to_owned(), format!("a delay{}", v(&["D"])))
        }
        "torque_saturation" => (
            format!("{who}: at high torque the drive gives less than it reports"),
            format!("a torque constant that falls above a knee{}", v(&["tau_k", "a"])),
        ),
        "air_drag" => {
            ("Air drags at the moving platform or tip".to_owned(), { format!("quadratic drag{}", v(&["c"])) })
        }
        "ball_friction" => {
            ("The passive joints of the legs rub".to_owned(), format!("friction in the joints{}", v(&["mu", "b"])))
        }
        "collision" => (
            format!("The robot touched something {}", times(f.intervals_s.len())),
            format!("a short contact force{}", v(&["F_x", "F_y", "F_z"])),
        ),
        other => (
            format!("{who}: {}", effects::find(other).map_or(other, |e| e.title)),
            "a term of the catalogue".to_owned(),
        ),
    }
}

fn carries(n: usize) -> String {
    if n == 1 { "one carry".to_owned() } else { format!("{n} carries") }
}

fn times(n: usize) -> String {
    if n == 1 { "once".to_owned() } else { format!("{n} times") }
}

impl Words<'_> {
    /// What the model was judged on.
    fn unseen(&self) -> &'static str {
        match self.split {
            "recordings" => "on recordings it had not seen",
            "files" => "on test data that neither chose nor fitted it",
            _ => "on stretches of time it had not seen",
        }
    }

    /// The sentence of a finding.
    pub fn sentence(&self, f: &Finding) -> String {
        let model = if self.against { "the simulator" } else { "the model" };
        let unit = self.unit;
        let gain = f.in_region.as_ref().unwrap_or(&f.held_out);
        let region = f.region.first().filter(|_| f.in_region.is_some() || f.effect == "unknown");
        let mut at = region.map_or_else(String::new, |r| place(r) + " ");
        if f.effect == "unknown" {
            let boxed = if gain.reduction > 0.1 {
                format!(
                    "a black box removes {:.0} % of it {}, so it is systematic",
                    100.0 * gain.reduction,
                    self.unseen()
                )
            } else {
                "a black box does not predict it either".to_owned()
            };
            if !at.is_empty() {
                at = format!(", mostly {}", at.trim_end());
            }
            return format!(
                "{} {} something that no effect of the catalogue explains: {} {unit} are left{at}; {boxed}.",
                joints(&f.joints),
                if f.joints.len() == 1 { "does" } else { "do" },
                digits(gain.before_rms_nm)
            );
        }
        let (what, term) = story(f);
        let missed = digits(gain.before_rms_nm);
        format!("{what}: {at}{model} misses {missed} {unit}; {term} {}.", self.removes(gain))
    }

    fn removes(&self, gain: &Reduction) -> String {
        let percent = 100.0 * gain.reduction;
        if gain.reduction > 0.005 {
            format!("removes {percent:.0} % of it {}", self.unseen())
        } else {
            format!("fits the training data, but removes nothing {}", self.unseen())
        }
    }

    /// The verdict of all findings: one sentence or two.
    pub fn verdict(&self, f: &Findings) -> String {
        let percent = |v: f64| format!("{:.1} %", 100.0 * v);
        let (before, after) = (percent(f.held_out.relative_before), percent(f.held_out.relative_after));
        let error = format!("the torque error there falls from {before} to {after}");
        match f.findings.as_slice() {
            [] if self.against => format!(
                "The simulator leaves out nothing that these recordings show. What is left of the torque {}, {after}, is noise and the robot file's tolerances.",
                self.unseen()
            ),
            [] => format!(
                "The model with viscous and Coulomb friction is complete within noise and the robot file's tolerances. It leaves {after} of the torque {}.",
                self.unseen()
            ),
            [one] if one.effect == "unknown" => {
                format!("{} Nothing of the catalogue helps: {after} of the torque are left.", one.sentence)
            }
            [one] => format!("{} With it {error}.", one.sentence),
            [first, rest @ ..] => {
                let named: Vec<String> = rest.iter().filter(|r| r.effect != "unknown").map(brief).collect();
                let unnamed = rest
                    .iter()
                    .find(|r| r.effect == "unknown")
                    .map(|r| format!("; something on {} stays without a name", joints(&r.joints).to_lowercase_first()));
                let also = if named.is_empty() { String::new() } else { format!("Also {}; ", named.join(", ")) };
                let all = if also.is_empty() { format!("With it {error}") } else { format!("with all of it {error}") };
                format!("{} {also}{all}{}.", first.sentence, unnamed.unwrap_or_default())
            }
        }
    }
}

/// An effect by its title, with its joints.
fn brief(f: &Finding) -> String {
    let title = effects::find(&f.effect).map_or(f.effect.clone(), |e| e.title.to_lowercase_first());
    let on = match f.joints.as_slice() {
        [] => String::new(),
        names => format!(" on {}", joints(names).to_lowercase_first()),
    };
    title + &on
}

/// Text in the middle of a sentence.
trait Lower {
    fn to_lowercase_first(&self) -> String;
}

impl Lower for str {
    fn to_lowercase_first(&self) -> String {
        let mut letters = self.chars();
        match (letters.next(), self.split(' ').next()) {
            // A name (Coulomb, Stribeck) keeps its capital.
            (Some(_), Some("Coulomb" | "Stribeck")) | (None, _) | (_, None) => self.to_owned(),
            (Some(first), _) => first.to_lowercase().chain(letters).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::findings::Reduction;

    fn reduction(before_rms_nm: f64, after_rms_nm: f64) -> Reduction {
        let reduction = 1.0 - after_rms_nm / before_rms_nm;
        Reduction { before_rms_nm, after_rms_nm, reduction, ci95: [0.8, 0.87] }
    }

    fn finding(effect: &str, joints: &[&str]) -> Finding {
        let parameter = |symbol: &str, value: f64, half: f64, unit: &str| Parameter {
            symbol: symbol.into(),
            unit: unit.into(),
            value,
            ci95: [value - half, value + half],
            joint: None,
        };
        Finding {
            effect: effect.into(),
            joints: joints.iter().map(|j| (*j).to_owned()).collect(),
            probability: 0.97,
            status: "named".into(),
            alternatives: Vec::new(),
            group: vec![effect.into()],
            equation: String::new(),
            sentence: String::new(),
            parameters: vec![parameter("v_s", 0.12, 0.02, "rad/s"), parameter("f_sc", 2.039, 0.0184, "Nm")],
            held_out: reduction(0.2, 0.1),
            region: vec![Region { variable: "qd_rad_s".into(), low: -0.2, high: 0.2 }],
            in_region: Some(reduction(0.31, 0.05)),
            stage: "friction".into(),
            intervals_s: Vec::new(),
        }
    }

    const WORDS: Words<'static> = Words { unit: "Nm", split: "recordings", against: false };

    #[test]
    fn a_sentence_says_what_where_how_much_and_what_helps() {
        assert_eq!(
            WORDS.sentence(&finding("stribeck", &["2"])),
            "Joint 2 sticks before it slides: below 0.200 rad/s the model misses 0.310 Nm; a Stribeck term \
             (v_s = 0.120 ± 0.020 rad/s, f_sc = 2.039 ± 0.018 Nm) removes 84 % of it on recordings it had not seen."
        );
        let mut worse = finding("coulomb_asym", &["q1", "q3"]);
        (worse.in_region, worse.held_out) = (None, reduction(0.2, 0.21));
        let words = Words { split: "files", against: true, ..WORDS }.sentence(&worse);
        assert!(words.starts_with("Joints q1 and q3 move harder one way"), "{words}");
        assert!(words.contains("the simulator misses 0.200 Nm") && words.contains("removes nothing"), "{words}");
    }

    #[test]
    fn every_effect_of_the_catalogue_has_words_of_its_own() {
        for effect in effects::registry() {
            let (what, term) = story(&finding(effect.id, &["q1"]));
            assert!(term != "a term of the catalogue", "{} has no words", effect.id);
            assert!(!what.is_empty() && !what.contains('_'), "{what}");
        }
    }

    #[test]
    fn uncertainty_decides_the_digits() {
        let shown = |v, half| {
            let (v, half) = rounded(v, half);
            format!("{v} ± {half}")
        };
        assert_eq!(shown(0.34854, 0.00046), "0.3485 ± 0.0005");
        assert_eq!(shown(123.4, 17.0), "123 ± 17");
        assert_eq!(shown(0.12, 0.02), "0.120 ± 0.020");
        assert_eq!(shown(0.191257, 2e-5), "0.19126 ± 0.00002");
        assert_eq!(shown(1.0, 1e-9), "1.0000 ± 1e-9");
    }
}
