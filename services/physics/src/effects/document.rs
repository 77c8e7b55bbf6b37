//! The catalogue as a page of documentation.

use super::catalogue::registry;
use super::effect::Effect;
use super::specification::{ParameterSpec, Regime, Robots, Role};
use std::fmt::Write;

/// The catalogue in Markdown: what `docs/EFFECTS.md` holds.
pub fn markdown() -> String {
    let mut out = String::from(HEAD);
    for effect in registry() {
        row(&mut out, effect);
    }
    out.push_str(TAIL);
    for effect in registry() {
        section(&mut out, effect);
    }
    out
}

const HEAD: &str = "# The catalogue of effects

Generated from `services/physics/src/effects/catalogue` by `cargo run -p lacuna-physics --example effects > docs/EFFECTS.md`; a test holds the two together.

A torque is what the drive must **add** because of the effect. Units are SI; Nm stands for the robot file's torque unit, and for N at prismatic joints. θ is the joint position, s = sgn θ̇ the direction of sliding (at standstill as the stage decides it), τ_link the torque that the gear passes to the link, τ the drive's predicted torque.

| id | law | memory | acts on | stage | cannot be told from | hardly told from |
|---|---|---|---|---|---|---|
";

const TAIL: &str = "
*Cannot be told from*: motor-side position and torque are the same. *Hardly told from*: ordinary recordings leave both open; findings then name the group. All terms of a model file run in the friction stage, the first that has motion, rigid-body torque and temperature together; *stage* says where the cause sits.
";

fn row(out: &mut String, e: &Effect) {
    let list = |ids: &[&str]| if ids.is_empty() { "-".to_owned() } else { ids.join(", ") };
    // Writing to a String cannot fail.
    let _ = writeln!(
        out,
        "| {} | {} | {} | {} | {} | {} | {} |",
        e.id,
        cell(e.law),
        e.memory.as_str(),
        e.scope.as_str(),
        e.stage.as_str(),
        list(e.exact_group),
        list(e.practical_group)
    );
}

fn section(out: &mut String, e: &Effect) {
    let _ = writeln!(out, "\n## {}\n\n**{}.** {}\n", e.id, e.title, e.words);
    let _ = writeln!(out, "Law: {}", e.law);
    let regimes = |list: &[Regime]| list.iter().map(|r| r.as_str()).collect::<Vec<_>>().join(", ");
    let _ = write!(out, "\nShows: {}.", regimes(e.appears));
    if !e.vanishes.is_empty() {
        let _ = write!(out, " Vanishes: {}.", regimes(e.vanishes));
    }
    if e.robots != Robots::Any {
        let _ = write!(out, " Exists for: {}.", e.robots.as_str());
    }
    let _ =
        writeln!(out, "\n\n| parameter | unit | role | bounds | if not given | meaning |\n|---|---|---|---|---|---|");
    for p in e.parameters {
        parameter(out, p);
    }
    let _ = writeln!(out, "\nReference: {}", e.reference);
}

fn parameter(out: &mut String, p: &ParameterSpec) {
    let role = match p.role {
        Role::Amplitude => "amplitude",
        Role::Shape => "shape",
    };
    let default = p.default.map_or("must be given".to_owned(), number);
    let robots = if p.robots == Robots::Any { String::new() } else { format!(" ({} only)", p.robots.as_str()) };
    let _ = writeln!(
        out,
        "| {} | {} | {role} | {} to {} | {default} | {}{robots} |",
        p.symbol,
        p.unit,
        number(p.lower),
        number(p.upper),
        cell(p.meaning)
    );
}

fn number(x: f64) -> String {
    if x == f64::INFINITY {
        "∞".to_owned()
    } else if x == f64::NEG_INFINITY {
        "−∞".to_owned()
    } else if x != 0.0 && (x.abs() < 1e-3 || x.abs() >= 1e6) {
        format!("{x:e}")
    } else {
        format!("{x}")
    }
}

fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}
