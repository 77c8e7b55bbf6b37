//! What every effect of the catalogue must keep to. One test walks the registry: a new effect is tested by
//! being in it.

mod common;
#[path = "common/effects.rs"]
mod support;

use common::{ARM, DELTA, DELTA_TILTED};
use lacuna_interfaces::{Joints, MAX_JOINTS};
use lacuna_physics::effects::{
    Effect, EffectContext, EffectSample, OwningStage, Regime, Role, Scope, Side, find, markdown, registry,
};
use std::collections::{BTreeMap, BTreeSet};
use support::{Robot, fits, joints, map, regime, rms, shapes, specs, torque_of, typical, with_drive};

fn robots() -> Vec<Robot> {
    [DELTA, DELTA_TILTED, ARM].iter().map(|text| Robot::new(&with_drive(text))).collect()
}

/// Every effect with every robot that can have it.
fn each(mut f: impl FnMut(&'static Effect, &Robot)) {
    let robots = robots();
    for effect in registry() {
        for robot in robots.iter().filter(|r| fits(effect, &r.file)) {
            f(effect, robot);
        }
    }
}

/// Random numbers that are the same everywhere (splitmix64), in [−1, 1].
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn joints(&mut self, size: f64) -> Joints {
        std::array::from_fn(|_| size * self.next())
    }
}

/// Owned values behind an [`EffectSample`].
struct Owned {
    t: f64,
    dt: f64,
    q: Joints,
    qd: Joints,
    qdd: Joints,
    direction: Joints,
    link: Joints,
    drive: Joints,
    temperature: Joints,
}

impl Owned {
    fn random(noise: &mut Noise, t: f64, size: f64) -> Self {
        Self {
            t,
            dt: 1e-3 * (1.0 + noise.next()),
            q: std::array::from_fn(|_| 0.3 + 0.3 * size.min(20.0) * noise.next()),
            qd: noise.joints(3.0 * size),
            qdd: noise.joints(50.0 * size * size),
            direction: noise.joints(1.0),
            link: noise.joints(20.0 * size),
            drive: noise.joints(20.0 * size),
            temperature: std::array::from_fn(|j| if j % 2 == 0 { 30.0 + 10.0 * noise.next() } else { f64::NAN }),
        }
    }

    fn sample(&self) -> EffectSample<'_> {
        EffectSample {
            t_s: self.t,
            dt_s: self.dt,
            q_rad: &self.q,
            qd_rad_s: &self.qd,
            qdd_rad_s2: &self.qdd,
            direction: &self.direction,
            ramp_rad_s: 0.01,
            tau_link_nm: &self.link,
            tau_drive_nm: &self.drive,
            temperature_degc: &self.temperature,
        }
    }
}

#[test]
fn registry_is_whole_and_said_in_words() {
    let ids: Vec<&str> = registry().iter().map(|e| e.id).collect();
    let table = "coulomb viscous coulomb_asym torque_offset stribeck viscous_power load_friction thermal_viscous \
                 presliding backlash cogging elasticity rotor_inertia arm_inertia axis_coupling forearm_rod kt_scale \
                 base_tilt encoder_offset link_length payload payload_ecc torque_delay torque_saturation \
                 gravity_spring cable_spring air_drag ball_friction collision";
    for id in table.split_whitespace() {
        assert!(ids.contains(&id), "{id} is missing");
        assert_eq!(find(id).unwrap().id, id);
    }
    assert_eq!(ids.iter().collect::<BTreeSet<_>>().len(), ids.len(), "an id is given twice");
    assert!(find("unknown").is_none() && find("").is_none());

    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/effects/catalogue");
    let files: BTreeSet<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|f| f.unwrap().file_name().into_string().unwrap().trim_end_matches(".rs").to_owned())
        .collect();
    assert_eq!(files, ids.iter().map(|id| (*id).to_owned()).collect(), "one file per effect, named by its id");

    for e in registry() {
        let id = e.id;
        for (what, text) in [("title", e.title), ("law", e.law), ("words", e.words), ("reference", e.reference)] {
            assert!(text.trim().len() > 2 && !text.contains('\n') && !text.contains("  "), "{id}: {what}: {text}");
        }
        assert!(e.words.ends_with('.') && e.reference.contains(['1', '2']), "{id}: a sentence, a year");
        assert!(!e.appears.is_empty(), "{id}: must appear somewhere");
        // What depends on the angle alone, or on nothing, has no motion without it.
        let everywhere = ["torque_offset", "cogging", "gravity_spring", "cable_spring"];
        assert_eq!(e.vanishes.is_empty(), everywhere.contains(&id), "{id}: vanishes");
        if e.side == Side::Drive {
            assert_eq!(e.stage, OwningStage::Source, "{id}: what the drive reports is measurement");
        }
    }
}

#[test]
fn parameters_have_units_bounds_and_sensible_sizes() {
    for e in registry() {
        let mut symbols = BTreeSet::new();
        for p in e.parameters {
            let place = format!("{}: {}", e.id, p.symbol);
            assert!(symbols.insert(p.symbol), "{place}: given twice");
            assert!(!p.unit.is_empty() && !p.meaning.is_empty(), "{place}");
            assert!(p.lower < p.upper, "{place}");
            assert!((p.lower..=p.upper).contains(&p.typical) && p.typical.is_finite(), "{place}: typical");
            if let Some(d) = p.default {
                assert!((p.lower..=p.upper).contains(&d), "{place}: default");
            }
            assert!(p.grid.iter().all(|g| (p.lower..=p.upper).contains(g)), "{place}: grid");
            assert!(p.grid.windows(2).all(|w| w[0] < w[1]), "{place}: grid in order");
            match p.role {
                Role::Amplitude => {
                    assert!(p.grid.is_empty(), "{place}: an amplitude is fitted, not searched");
                    assert!((p.lower..=p.upper).contains(&0.0), "{place}: an effect may be absent");
                    assert!(p.default.is_none_or(|d| d == 0.0), "{place}: not given means absent");
                }
                Role::Shape if p.default.is_none() && p.unit != "s" => {
                    assert!(!p.grid.is_empty(), "{place}: where does a search start?");
                }
                Role::Shape => {}
            }
        }
        let first_shape = e.parameters.iter().position(|p| p.role == Role::Shape).unwrap_or(e.parameters.len());
        assert!(e.parameters[first_shape..].iter().all(|p| p.role == Role::Shape), "{}: amplitudes first", e.id);
        let amplitudes = e.parameters.iter().filter(|p| p.role == Role::Amplitude).count();
        for p in e.parameters.iter().filter(|p| p.role == Role::Amplitude) {
            assert_eq!(p.default.is_none(), amplitudes == 1, "{}: {}: one of several may be left out", e.id, p.symbol);
        }
    }
}

#[test]
fn groups_are_symmetric() {
    for e in registry() {
        for (name, pick) in [
            ("exact", (|e| e.exact_group) as fn(&Effect) -> &'static [&'static str]),
            ("practical", |e| e.practical_group),
        ] {
            for other in pick(e) {
                let other = find(other).unwrap_or_else(|| panic!("{}: {other} is not in the catalogue", e.id));
                assert_ne!(other.id, e.id);
                assert!(pick(other).contains(&e.id), "{name} group of {} names {}, not the reverse", e.id, other.id);
            }
        }
        assert!(!e.exact_group.iter().any(|id| e.practical_group.contains(id)), "{}: exact or practical", e.id);
    }
}

/// Shows where it must, vanishes where it must.
#[test]
fn appears_and_vanishes() {
    each(|effect, robot| {
        let c = robot.context();
        let size = |r: Regime| {
            let (body, pi);
            let c = match r {
                Regime::WeightlessRest => {
                    body = c.body.with_gravity([0.0; 3]);
                    EffectContext { body: body.as_ref(), ..c }
                }
                Regime::Massless => {
                    pi = vec![0.0; c.pi.len()];
                    EffectContext { pi: &pi, ..c }
                }
                _ => c,
            };
            let signals = regime(&c, r);
            rms(&torque_of(effect, &joints(effect, robot.n()), &typical(effect, &robot.file), &c, &signals))
        };
        let (id, name) = (effect.id, &robot.file.name);
        let mut least = f64::INFINITY;
        for &r in effect.appears {
            let found = size(r);
            assert!(found > 2e-3, "{id} on {name}: {found:.2e} Nm, must show {}", r.as_str());
            least = least.min(found);
        }
        for &r in effect.vanishes {
            let found = size(r);
            assert!(found < 1e-9 * least, "{id} on {name}: {found:.2e} Nm, must vanish {}", r.as_str());
        }
    });
}

/// Columns times amplitudes are the streamed torque; a second run after a reset is the first, bit by bit.
#[test]
fn stream_and_columns_are_one() {
    each(|effect, robot| {
        let c = robot.context();
        let (at, parameters) = (joints(effect, robot.n()), typical(effect, &robot.file));
        let signals = regime(&c, Regime::Shaking);
        let expected = torque_of(effect, &at, &parameters, &c, &signals);
        let mut term = effect.term(&at, &parameters, &c).unwrap();
        let mut run = || -> Vec<Joints> {
            term.reset();
            (0..signals.t.len())
                .map(|k| {
                    let wide =
                        |s: &Vec<Vec<f64>>| -> Joints { std::array::from_fn(|j| s.get(j).map_or(0.0, |s| s[k])) };
                    let [q, qd, qdd] = [&signals.q, &signals.qd, &signals.qdd].map(wide);
                    let [direction, link, drive] = [&signals.direction, &signals.link, &signals.drive].map(wide);
                    let mut tau = [0.0; MAX_JOINTS];
                    let dt_s = if k == 0 { 0.0 } else { signals.t[k] - signals.t[k - 1] };
                    let sample = EffectSample {
                        t_s: signals.t[k],
                        dt_s,
                        q_rad: &q,
                        qd_rad_s: &qd,
                        qdd_rad_s2: &qdd,
                        direction: &direction,
                        ramp_rad_s: 0.01,
                        tau_link_nm: &link,
                        tau_drive_nm: &drive,
                        temperature_degc: &wide(&signals.temperature),
                    };
                    term.add_torque(&sample, &mut tau);
                    tau
                })
                .collect()
        };
        let (first, second) = (run(), run());
        for (k, tau) in first.iter().enumerate() {
            assert_eq!(tau.map(f64::to_bits), second[k].map(f64::to_bits), "{}: run twice, sample {k}", effect.id);
            for j in 0..MAX_JOINTS {
                let e = expected.get(j).map_or(0.0, |s| s[k]);
                assert!((tau[j] - e).abs() <= 1e-9, "{} on {}: sample {k} joint {j}", effect.id, robot.file.name);
            }
        }
    });
}

/// Joint effects act on the joints asked for; what lies in motor, gear or drive of one stays there.
#[test]
fn effects_stay_where_they_are_put() {
    each(|effect, robot| {
        if effect.scope != Scope::Joint || matches!(effect.id, "elasticity" | "backlash") {
            return;
        }
        if effect.side == Side::Link && !matches!(effect.id, "gravity_spring" | "cable_spring") {
            return;
        }
        let c = robot.context();
        let signals = regime(&c, Regime::Shaking);
        let at = robot.n() - 1;
        let tau = torque_of(effect, &[at], &typical(effect, &robot.file), &c, &signals);
        for (j, s) in tau.iter().enumerate().filter(|(j, _)| *j != at) {
            assert!(s.iter().all(|v| *v == 0.0), "{}: joint {j} feels joint {at}", effect.id);
        }
    });
}

/// No motion, however wild, makes a torque that is not a number, at the edges of the shapes' bounds either.
#[test]
fn finite_on_all_states() {
    each(|effect, robot| {
        let c = robot.context();
        let edges = specs(effect, &robot.file).filter(|p| p.role == Role::Shape && p.lower.is_finite());
        let mut sets = vec![typical(effect, &robot.file)];
        for p in edges {
            for v in [p.lower, p.upper] {
                let mut set = typical(effect, &robot.file);
                set.insert(p.symbol.to_owned(), v);
                sets.push(set);
            }
        }
        for parameters in sets {
            let mut term = effect.term(&joints(effect, robot.n()), &parameters, &c).unwrap();
            let mut noise = Noise(7);
            for k in 0..300 {
                let size = [1.0, 1e3, 1e-3, 0.0, 1e6][k % 5];
                let mut owned = Owned::random(&mut noise, 0.002 * k as f64, size);
                if k % 37 == 36 {
                    owned.dt = [0.0, -1.0, 1e9, 1e-12][k / 37 % 4];
                }
                let mut tau = [0.0; MAX_JOINTS];
                term.add_torque(&owned.sample(), &mut tau);
                assert!(tau.iter().all(|v| v.is_finite()), "{} {parameters:?} sample {k}: {tau:?}", effect.id);
            }
            // Nonsense adds nothing bad either, and the term recovers from it.
            for bad in [f64::NAN, f64::INFINITY] {
                let mut owned = Owned::random(&mut noise, 1.0, 1.0);
                owned.qd = [bad; MAX_JOINTS];
                owned.q[1] = bad;
                owned.dt = bad;
                let mut tau = [0.0; MAX_JOINTS];
                term.add_torque(&owned.sample(), &mut tau);
                assert!(tau.iter().all(|v| v.is_finite()), "{}: {bad}", effect.id);
            }
        }
        // A sample of nonsense is forgotten: without a reset the torque comes back.
        if effect.appears.contains(&Regime::Shaking) || effect.appears.contains(&Regime::Reversals) {
            let parameters = typical(effect, &robot.file);
            let mut signals = regime(&c, Regime::Shaking);
            for s in signals.q.iter_mut().chain(&mut signals.qd).chain(&mut signals.drive).chain(&mut signals.link) {
                s[100] = f64::NAN;
            }
            let tau = torque_of(effect, &joints(effect, robot.n()), &parameters, &c, &signals);
            assert!(rms(&tau) > 1e-3, "{}: silent after a sample of nonsense", effect.id);
        }
    });
}

/// What is said to dissipate takes power from the drives at every sample.
#[test]
fn dissipative_effects_take_power() {
    let said: Vec<&str> = registry().iter().filter(|e| e.dissipative).map(|e| e.id).collect();
    for id in ["coulomb", "viscous", "stribeck", "viscous_power", "load_friction", "air_drag", "ball_friction"] {
        assert!(said.contains(&id), "{id} dissipates");
    }
    each(|effect, robot| {
        if !effect.dissipative {
            return;
        }
        let c = robot.context();
        let n = robot.n();
        let at: Vec<usize> = if effect.scope == Scope::Joint { (0..n).collect() } else { Vec::new() };
        let mut term = effect.term(&at, &typical(effect, &robot.file), &c).unwrap();
        let mut noise = Noise(3);
        for k in 0..500 {
            let mut owned = Owned::random(&mut noise, 0.001 * f64::from(k), 1.0);
            owned.direction = owned.qd.map(f64::signum);
            let mut tau = [0.0; MAX_JOINTS];
            term.add_torque(&owned.sample(), &mut tau);
            let power: f64 = (0..n).map(|j| tau[j] * owned.qd[j]).sum();
            assert!(power >= -1e-12, "{} gives {power} W", effect.id);
        }
    });
}

/// What cannot be used is refused in one line that says what was expected.
#[test]
fn bad_terms_are_refused_in_words() {
    each(|effect, robot| {
        let c = robot.context();
        let id = effect.id;
        let at = joints(effect, robot.n());
        let good = typical(effect, &robot.file);
        let refused = |joints: &[usize], parameters: &BTreeMap<String, f64>, expected: &str| {
            let e = effect.term(joints, parameters, &c).expect_err(id).to_string();
            assert!(e.contains(id) && e.contains(expected) && !e.contains('\n'), "{id}: '{expected}' not in '{e}'");
        };
        let with = |symbol: &str, v: f64| {
            let mut p = good.clone();
            p.insert(symbol.to_owned(), v);
            p
        };
        refused(&at, &with("nonsense", 1.0), "found parameter \"nonsense\"; expected");
        refused(&[robot.n()], &good, "joints");
        for p in specs(effect, &robot.file) {
            for v in [f64::NAN, f64::INFINITY] {
                refused(&at, &with(p.symbol, v), p.symbol);
            }
            if p.upper < 1e100 {
                refused(&at, &with(p.symbol, p.upper + 1.0), "expected");
                refused(&at, &with(p.symbol, p.lower - 1.0), "expected");
            }
            if p.default.is_none() {
                let mut p_missing = good.clone();
                p_missing.remove(p.symbol);
                refused(&at, &p_missing, &format!("found no {}", p.symbol));
            }
        }
        if effect.amplitudes(robot.file.kind).count() > 1 {
            refused(&at, &shapes(effect, &robot.file), "no amplitude");
        }
        match effect.scope {
            Scope::Joint => refused(&[], &good, "at least one"),
            Scope::Pair => refused(&[0], &good, "two"),
            Scope::Structure => refused(&[0], &good, "whole structure"),
            Scope::Drive => {}
        }
        if effect.scope != Scope::Structure {
            refused(&[0, 0], &good, "each joint once");
        }
    });
    let arm = Robot::new(ARM);
    for id in ["forearm_rod", "ball_friction"] {
        let effect = find(id).unwrap();
        let e = effect.term(&[], &map(&[]), &arm.context()).unwrap_err().to_string();
        assert!(e.contains("not a Delta"), "{e}");
    }
    let e = find("thermal_viscous").unwrap().term(&[0], &map(&[("b_T", -0.1)]), &arm.context()).unwrap_err();
    assert!(e.what.contains("columns.temperature"), "{e}");
}

#[test]
fn docs_are_the_registry() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/EFFECTS.md");
    let found = std::fs::read_to_string(path).unwrap_or_default();
    assert!(
        found == markdown(),
        "docs/EFFECTS.md is out of date: cargo run -p lacuna-physics --example effects > docs/EFFECTS.md"
    );
}
