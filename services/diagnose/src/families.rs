//! The catalogue as candidates: which amplitudes enter together, which shapes are tried, in what range they
//! are refined. Laws and columns are `lacuna_physics::effects`'; nothing physical is computed here.

use crate::scene::{Raw, Scene};
use lacuna_estimation::stats;
use lacuna_interfaces::robot::Kind;
use lacuna_physics::Motion;
use lacuna_physics::effects::{self, Effect, EffectContext, Scope, Side, Track};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// What the model says so far, for candidates that depend on it.
pub struct Context<'a> {
    /// The recordings.
    pub scene: &'a Scene,
    /// Direction of sliding of each joint, −1 to 1, full rate.
    pub stick: Raw,
    /// Dynamic parameters of the model so far.
    pub pi: Vec<f64>,
    /// Torque of the whole model, full rate.
    pub predicted: Raw,
    /// Torque past the rotor: rigid body and what is carried, without friction, full rate.
    pub link: Raw,
    /// Whether the robot file's masses are the base; otherwise base parameters are fitted freely.
    pub nominal_base: bool,
    /// Whether sensors measured the torque behind the gears: then only drive and gear are in question.
    pub measured_load: bool,
    /// 75 % point of the speed of each joint [rad/s].
    pub speed: Vec<f64>,
    /// Lowest and highest position of each joint [rad].
    pub range: Vec<(f64, f64)>,
    /// Link-side inertia of each joint at its median pose [kg m²]; 0 if the robot file has no masses.
    pub inertia: Vec<f64>,
    /// Rotor inertia of each joint at the joint side [kg m²].
    pub rotor: Vec<f64>,
}

/// How a shape parameter is searched.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeRange {
    /// Symbol.
    pub symbol: &'static str,
    /// Values to start from.
    pub grid: Vec<f64>,
    /// Range of refinement; `None`: it stays on the grid.
    pub bounds: Option<(f64, f64)>,
}

/// An effect as the search takes it.
pub struct Family {
    /// The catalogue's entry.
    pub effect: &'static Effect,
    /// Amplitudes that are fitted; the others are zero. Empty: the effect has none and acts in full.
    pub keep: &'static [&'static str],
    /// Needs the robot file's masses as the base.
    needs_masses: bool,
    /// Its columns change with the model's torque.
    pub dynamic: bool,
    /// Its shape is simulated, dear and sharp.
    pub driven: bool,
    /// One candidate may stand for all joints.
    pub whole_robot: bool,
    /// It comes and goes: found by `events`, not by columns.
    pub event: bool,
    shapes: Shapes,
}

/// How the shapes of an effect are searched at a joint.
type Shapes = fn(&Context<'_>, usize) -> Vec<ShapeRange>;
/// Id, amplitudes, traits (see [`Family`]), shapes.
type Line = (&'static str, &'static [&'static str], &'static str, Shapes);

/// Effects that the search takes as columns; payload in carries and collisions are found by their events.
pub fn all() -> Vec<Family> {
    let list: [Line; 34] = [
        ("coulomb_asym", &["a_c"], "masses whole", none),
        ("stribeck", &["f_sc"], "whole", stribeck),
        ("viscous_power", &["a"], "whole", power),
        ("load_friction", &["mu"], "dynamic whole", none),
        ("load_friction", &["mu_v"], "dynamic whole", none),
        ("thermal_viscous", &["b"], "whole", warming),
        ("thermal_viscous", &["b_T"], "whole", temperature),
        ("thermal_viscous", &["c_T"], "whole", temperature),
        ("presliding", &["f"], "whole", presliding),
        ("backlash", &[], "masses dynamic driven", backlash),
        ("cogging", &["a_s", "a_c"], "", cogging),
        ("elasticity", &[], "masses dynamic driven", elasticity),
        ("rotor_inertia", &["J"], "masses whole", none),
        ("arm_inertia", &["I", "m_1"], "masses whole", none),
        ("axis_coupling", &["J", "f_v", "f_c"], "", coupling),
        ("forearm_rod", &["ds_1", "ds_2"], "masses", none),
        ("forearm_rod", &["dm"], "masses", none),
        ("kt_scale", &["g"], "masses dynamic", none),
        ("base_tilt", &["tilt_1", "tilt_2"], "masses", none),
        ("encoder_offset", &["q_0"], "masses", none),
        ("link_length", &["dl"], "masses", none),
        ("link_length", &["dl_2"], "masses", none),
        ("payload", &["m"], "masses", none),
        ("torque_delay", &[], "dynamic", delay),
        ("torque_saturation", &["a"], "dynamic whole", saturation),
        ("gravity_spring", &["a_s", "a_c"], "whole", none),
        ("cable_spring", &["k_1", "k_3"], "whole", cable),
        ("air_drag", &["c"], "", none),
        ("ball_friction", &["mu", "b"], "", turning),
        ("ball_friction", &["b"], "", none),
        ("arm_inertia", &["I", "m_1", "m_2"], "masses whole", none),
        ("payload", &["m"], "event", none),
        ("payload_ecc", &["m_x", "m_y"], "masses event", swung),
        ("collision", &["F_x", "F_y", "F_z"], "event", contact),
    ];
    list.into_iter()
        .filter_map(|(id, keep, traits, shapes)| {
            let has = |word: &str| traits.split(' ').any(|t| t == word);
            Some(Family {
                effect: effects::find(id)?,
                keep,
                needs_masses: has("masses"),
                dynamic: has("dynamic"),
                driven: has("driven"),
                whole_robot: has("whole"),
                event: has("event"),
                shapes,
            })
        })
        .collect()
}

impl Family {
    /// Catalogue id.
    pub fn id(&self) -> &'static str {
        self.effect.id
    }

    /// Name in calibration files: id and amplitudes.
    pub fn key(&self) -> String {
        if self.event { format!("{}:event", self.id()) } else { format!("{}:{}", self.id(), self.keep.join("+")) }
    }

    /// Whether it acts on one joint (otherwise on a pair or the structure).
    pub fn per_joint(&self) -> bool {
        matches!(self.effect.scope, Scope::Joint | Scope::Pair)
    }

    /// Whether it acts in full, without an amplitude.
    pub fn fixed(&self) -> bool {
        self.keep.is_empty()
    }

    /// Whether its columns are the first order of a law that is not linear in its numbers.
    pub fn first_order(&self) -> bool {
        matches!(self.effect.id, "link_length" | "encoder_offset" | "base_tilt")
    }

    /// Joints of an instance at `joint`.
    pub fn joints(&self, joint: usize) -> Vec<usize> {
        match self.effect.scope {
            Scope::Joint => vec![joint],
            Scope::Pair => vec![joint, joint + 1],
            Scope::Structure | Scope::Drive => Vec::new(),
        }
    }

    /// Shape parameters and how they are searched; `None` if it does not apply here.
    pub fn shapes(&self, ctx: &Context<'_>, joint: usize) -> Option<Vec<ShapeRange>> {
        let scene = ctx.scene;
        if !self.effect.robots.include(scene.robot.kind)
            || (self.needs_masses && !ctx.nominal_base && !(ctx.measured_load && self.effect.id == "kt_scale"))
            // The sensor measures what the link does, and its lag is in the base.
            || (ctx.measured_load && (self.effect.side == Side::Link || self.effect.id == "torque_delay"))
            || (self.effect.scope == Scope::Pair && (joint + 1 >= scene.joints || scene.robot.kind == Kind::Delta))
        {
            return None;
        }
        let shapes = (self.shapes)(ctx, joint);
        (!shapes.iter().any(|s| s.grid.is_empty())).then_some(shapes)
    }

    /// Whether its shape can be refined off the grid.
    pub fn refinable(&self, ctx: &Context<'_>, joint: usize) -> bool {
        self.shapes(ctx, joint).is_some_and(|s| s.iter().any(|s| s.bounds.is_some()))
    }

    /// All combinations of the grids.
    pub fn grid(&self, ctx: &Context<'_>, joint: usize) -> Vec<Vec<f64>> {
        let Some(shapes) = self.shapes(ctx, joint) else { return Vec::new() };
        let mut out = vec![Vec::new()];
        for s in &shapes {
            out = out
                .iter()
                .flat_map(|head| {
                    s.grid.iter().map(move |v| {
                        let mut next: Vec<f64> = head.clone();
                        next.push(*v);
                        next
                    })
                })
                .collect();
        }
        out
    }

    /// Parameters of an instance as a model file has them.
    pub fn parameters(
        &self,
        ctx: &Context<'_>,
        joint: usize,
        shape: &[f64],
        amplitude: &[f64],
    ) -> BTreeMap<String, f64> {
        let shapes = self.shapes(ctx, joint).unwrap_or_default();
        let mut out: BTreeMap<String, f64> = shapes.iter().zip(shape).map(|(s, v)| (s.symbol.to_owned(), *v)).collect();
        out.extend(self.keep.iter().zip(amplitude).map(|(s, v)| ((*s).to_owned(), *v)));
        out
    }

    /// Columns at a shape, full rate.
    pub fn raws(&self, ctx: &Context<'_>, joint: usize, shape: &[f64]) -> Vec<Raw> {
        let scene = ctx.scene;
        let robot =
            EffectContext { robot: &scene.robot, urdf: scene.urdf.as_deref(), body: scene.body.as_ref(), pi: &ctx.pi };
        let parameters = self.parameters(ctx, joint, shape, &[]);
        let joints = self.joints(joint);
        let count = self.keep.len().max(1);
        let along = |p: usize| -> Vec<Vec<Vec<f64>>> {
            let piece = &scene.pieces[p];
            let t_s: Vec<f64> = (0..piece.len()).map(|k| k as f64 / scene.rate_hz).collect();
            let track = Track {
                t_s: &t_s,
                start_s: piece.global_s,
                q_rad: &piece.q,
                qd_rad_s: &piece.qd,
                qdd_rad_s2: &piece.qdd,
                direction: &ctx.stick[p],
                ramp_rad_s: 0.01,
                tau_link_nm: &ctx.link[p],
                tau_drive_nm: &ctx.predicted[p],
                temperature_degc: &piece.temperature,
                resets: &[],
            };
            let Ok(columns) = self.effect.columns(&joints, &parameters, &robot, &track) else {
                return vec![vec![Vec::new(); scene.joints]; count];
            };
            let at = |c: usize| {
                let amplitude = self.keep.get(c);
                amplitude.and_then(|s| self.effect.amplitudes(scene.robot.kind).position(|a| a.symbol == *s))
            };
            let signal = |index: usize, j: usize| match columns.column(index, j) {
                s if s.iter().all(|v| *v == 0.0) => Vec::new(),
                s => s.to_vec(),
            };
            (0..count).map(|c| (0..scene.joints).map(|j| signal(at(c).unwrap_or(0), j)).collect()).collect()
        };
        // A simulated column is dear: the recordings are simulated side by side.
        let pieces: Vec<Vec<Vec<Vec<f64>>>> = (0..scene.pieces.len()).into_par_iter().map(along).collect();
        let mut out: Vec<Raw> = vec![Vec::with_capacity(pieces.len()); count];
        for piece in pieces {
            out.iter_mut().zip(piece).for_each(|(raw, signals)| raw.push(signals));
        }
        out
    }

    /// Whether amplitudes are within the catalogue's bounds and large enough to mean something.
    pub fn admissible(&self, ctx: &Context<'_>, joint: usize, shape: &[f64], amplitude: &[f64]) -> bool {
        let scene = ctx.scene;
        for (symbol, v) in self.keep.iter().zip(amplitude) {
            let Some(spec) = self.effect.parameters.iter().find(|p| p.symbol == *symbol) else { continue };
            // Of several amplitudes one may be a little negative by noise: it is the leading one that decides.
            let first = self.keep.first() == Some(symbol);
            if first && !(spec.lower..=spec.upper).contains(v) {
                return false;
            }
        }
        match self.effect.id {
            // Below a good half of a sample it is a matter of when a drive stamps its samples.
            // At an end of what is searched it is not a delay but something that a delay is nearest to.
            "torque_delay" => {
                let (low, high) = delay_bounds(scene);
                shape.first().is_some_and(|d| d.abs() > 0.6 / scene.rate_hz && *d > 0.98 * low && *d < 0.98 * high)
            }
            // The smallest distance that is searched stands for a kink at reversals, not for friction that builds up.
            "presliding" => shape.first().is_some_and(|d| *d > 1.1 * presliding_bounds(ctx, joint).0),
            "viscous_power" => shape.first().is_some_and(|p| (p - 1.0).abs() > 0.12),
            "thermal_viscous" if self.keep.first() == Some(&"b_T") => amplitude.first().is_some_and(|b| *b < 0.0),
            "load_friction" => amplitude.first().is_some_and(|m| *m < 0.6),
            // A spring that pulls back; the cubic alone has wells elsewhere, in which it pushes.
            "cable_spring" => amplitude.iter().all(|k| *k >= 0.0),
            "kt_scale" => amplitude.first().is_some_and(|m| m.abs() < 0.6),
            _ => true,
        }
    }

    /// Ids that these signals cannot tell from it, itself first.
    pub fn group(&self) -> Vec<&'static str> {
        let mut out = vec![self.effect.id];
        let exact: &[&'static str] = match (self.effect.id, self.keep) {
            // With both inertia and moment it is no rotor and no spring alone.
            ("arm_inertia", _) => &[],
            ("gravity_spring", _) => &["arm_inertia"],
            _ => self.effect.exact_group,
        };
        out.extend(exact.iter().copied());
        out
    }
}

fn none(_: &Context<'_>, _: usize) -> Vec<ShapeRange> {
    Vec::new()
}

fn one(symbol: &'static str, grid: Vec<f64>, bounds: (f64, f64)) -> Vec<ShapeRange> {
    vec![ShapeRange { symbol, grid, bounds: Some(bounds) }]
}

/// Logarithmically even values.
fn log_grid(low: f64, high: f64, count: usize) -> Vec<f64> {
    (0..count).map(|i| low * (high / low).powf(i as f64 / (count.max(2) - 1) as f64)).collect()
}

fn stribeck(ctx: &Context<'_>, j: usize) -> Vec<ShapeRange> {
    let low = 0.5 * ctx.scene.slow_rad_s[j];
    let high = (0.3 * ctx.speed[j]).max(4.0 * low);
    one("v_s", log_grid(1.2 * low, 0.8 * high, 6), (low, high))
}

fn power(_: &Context<'_>, _: usize) -> Vec<ShapeRange> {
    one("p", vec![0.4, 0.65, 1.5, 2.0, 2.5, 3.0], (0.2, 4.0))
}

fn warming(ctx: &Context<'_>, _: usize) -> Vec<ShapeRange> {
    let end = ctx.scene.pieces.iter().map(|p| p.global_s + p.len() as f64 / ctx.scene.rate_hz).fold(1.0, f64::max);
    one("tau_w", log_grid(0.25 * end, 5.0 * end, 4), (0.15 * end, 8.0 * end))
}

fn temperature(ctx: &Context<'_>, j: usize) -> Vec<ShapeRange> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for v in ctx.scene.pieces.iter().filter_map(|p| p.temperature.get(j)).flatten() {
        low = low.min(*v);
        high = high.max(*v);
    }
    // Less than a degree of change says nothing.
    let grid = if high - low > 1.0 { vec![0.5 * (low + high)] } else { Vec::new() };
    vec![ShapeRange { symbol: "T_ref", grid, bounds: None }]
}

fn presliding(ctx: &Context<'_>, j: usize) -> Vec<ShapeRange> {
    let (low, high) = presliding_bounds(ctx, j);
    one("delta", log_grid(1.3 * low, 0.7 * high, 6), (low, high))
}

fn presliding_bounds(ctx: &Context<'_>, j: usize) -> (f64, f64) {
    let span = (ctx.range[j].1 - ctx.range[j].0).min(1.0);
    (0.0015 * span, 0.12 * span)
}

/// Stiffness of a spring that lets the link swing at `hz`.
fn stiffness(ctx: &Context<'_>, j: usize, hz: f64) -> f64 {
    ctx.inertia[j] * (std::f64::consts::TAU * hz).powi(2)
}

fn elasticity(ctx: &Context<'_>, j: usize) -> Vec<ShapeRange> {
    if ctx.inertia[j] <= 0.0 {
        return vec![ShapeRange { symbol: "k", grid: Vec::new(), bounds: None }];
    }
    let top = 1.3 * ctx.scene.band_hz;
    let k = |hz: f64| stiffness(ctx, j, hz);
    vec![
        ShapeRange {
            symbol: "k",
            grid: log_grid(0.15 * top, top, 8).into_iter().map(k).collect(),
            bounds: Some((k(0.1 * top), k(1.5 * top))),
        },
        ShapeRange { symbol: "zeta", grid: vec![0.04], bounds: Some((0.005, 0.5)) },
    ]
}

fn backlash(ctx: &Context<'_>, j: usize) -> Vec<ShapeRange> {
    if ctx.inertia[j] <= 0.0 {
        return vec![ShapeRange { symbol: "b", grid: Vec::new(), bounds: None }];
    }
    let band = ctx.scene.band_hz;
    vec![
        // Screened, not gridded.
        ShapeRange { symbol: "b", grid: vec![1e-3], bounds: Some((1e-4, 2e-2)) },
        ShapeRange {
            symbol: "k",
            grid: vec![stiffness(ctx, j, 1.2 * band)],
            bounds: Some((stiffness(ctx, j, 0.4 * band), stiffness(ctx, j, 4.0 * band))),
        },
        ShapeRange { symbol: "zeta", grid: vec![0.04], bounds: Some((0.005, 0.5)) },
    ]
}

fn cogging(ctx: &Context<'_>, j: usize) -> Vec<ShapeRange> {
    let scene = ctx.scene;
    let gear = scene.robot.drive.gear_ratio.as_ref().and_then(|g| g.get(j)).unwrap_or(1.0).abs();
    // Below a few turns over the range it is a spring; above the band at low speed it cannot be seen.
    let span = ctx.range[j].1 - ctx.range[j].0;
    let slow = (2.0 * scene.slow_rad_s[j]).max(0.1 * ctx.speed[j]);
    let most = std::f64::consts::TAU * scene.band_hz / slow;
    let grid = effects::catalogue::cogging::candidate_orders(&scene.robot, j)
        .into_iter()
        .filter(|h| h * gear * span > 3.0 * std::f64::consts::TAU && h * gear < most)
        .collect();
    vec![ShapeRange { symbol: "h", grid, bounds: None }]
}

fn coupling(_: &Context<'_>, _: usize) -> Vec<ShapeRange> {
    vec![ShapeRange { symbol: "rho", grid: vec![-1.0, 1.0], bounds: None }]
}

fn delay_bounds(scene: &Scene) -> (f64, f64) {
    let dt = 1.0 / scene.rate_hz;
    ((-0.005f64).max(-5.0 * dt), 0.05f64.min(20.0 * dt))
}

fn delay(ctx: &Context<'_>, _: usize) -> Vec<ShapeRange> {
    let dt = 1.0 / ctx.scene.rate_hz;
    let bounds = delay_bounds(ctx.scene);
    one("D", [-2.0, -1.0, -0.7, 0.7, 1.0, 2.0, 4.0].iter().map(|n| n * dt).filter(|d| *d > bounds.0).collect(), bounds)
}

fn saturation(ctx: &Context<'_>, j: usize) -> Vec<ShapeRange> {
    let stride = ctx.scene.stride;
    let sizes: Vec<f64> = ctx.predicted.iter().flat_map(|p| p[j].iter().step_by(stride).map(|v| v.abs())).collect();
    let at = |p: f64| stats::quantile(&sizes, p);
    vec![
        ShapeRange {
            symbol: "tau_k",
            grid: [0.5, 0.7, 0.85, 0.93].map(at).to_vec(),
            bounds: Some((at(0.4), at(0.97))),
        },
        ShapeRange { symbol: "p", grid: vec![1.0, 2.0], bounds: None },
    ]
}

fn cable(ctx: &Context<'_>, j: usize) -> Vec<ShapeRange> {
    let (low, high) = ctx.range[j];
    let at = |t: f64| low + t * (high - low);
    one("q_0", (-2..=10).map(|i| at(0.125 * f64::from(i))).collect(), (at(-0.5), at(1.5)))
}

fn turning(_: &Context<'_>, _: usize) -> Vec<ShapeRange> {
    one("omega_0", vec![0.05], (0.002, 0.5))
}

fn swung(ctx: &Context<'_>, _: usize) -> Vec<ShapeRange> {
    match ctx.scene.robot.kind {
        Kind::Delta => vec![ShapeRange { symbol: "omega", grid: vec![12.0], bounds: None }],
        // An arm's wrist is a joint: its angle is known.
        Kind::Serial => Vec::new(),
    }
}

fn contact(_: &Context<'_>, _: usize) -> Vec<ShapeRange> {
    vec![
        ShapeRange { symbol: "t_0", grid: vec![0.0], bounds: None },
        ShapeRange { symbol: "T", grid: vec![0.04], bounds: None },
    ]
}

/// Link-side inertia of each joint at its median pose.
pub fn link_inertia(scene: &Scene, rotor: &[f64]) -> Vec<f64> {
    let n = scene.joints;
    let q: Vec<f64> = (0..n)
        .map(|i| {
            stats::median(&scene.pieces.iter().flat_map(|p| p.q[i].iter().copied().step_by(20)).collect::<Vec<_>>())
        })
        .collect();
    let zero = vec![0.0; n];
    (0..n)
        .map(|j| {
            let mut unit = zero.clone();
            unit[j] = 1.0;
            let (mut with, mut without) = (zero.clone(), zero.clone());
            let ok = scene
                .body
                .torque(&Motion { q_rad: &q, qd_rad_s: &zero, qdd_rad_s2: &unit }, &scene.pi, &mut with)
                .is_ok()
                && scene
                    .body
                    .torque(&Motion { q_rad: &q, qd_rad_s: &zero, qdd_rad_s2: &zero }, &scene.pi, &mut without)
                    .is_ok();
            if ok { (with[j] - without[j] - rotor[j]).max(0.0) } else { 0.0 }
        })
        .collect()
}
