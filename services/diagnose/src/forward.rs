//! Forward simulation: how far the model's motion runs away from the recorded one when both get the recorded torque.
//!
//! From the recorded state at the beginning of a window, along the recorded motion, to first order in the deviation e:
//! M(q) ë + D ė = r, with r = τ − τ_model(q, θ̇, θ̈) what the model leaves. Windows are short, so that e stays small.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | M | mass matrix of the model | kg m² |
//! | D | its viscous friction | Nm s/rad |

use crate::context::free_parameters;
use crate::model::{BaseRole, Model};
use crate::proof::{Bare, Proof};
use crate::report::Material;
use crate::scene::{Piece, Raw, Scene};
use crate::transfer::{Fitted, Transferred};
use lacuna_physics::{Motion, RigidBody};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Length of a window [s].
pub const HORIZON_S: f64 = 0.1;
/// How long a mass matrix is kept [s].
const KEEP_S: f64 = 0.02;
/// Fewest windows that say something.
const LEAST: usize = 10;

/// RMS deviation at the end of a window, per joint.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Forward {
    /// With the base alone [rad].
    pub off_rad: Vec<f64>,
    /// With all findings [rad].
    pub on_rad: Vec<f64>,
    /// Windows.
    pub windows: usize,
}

/// Simulates both models along the judged recordings; `None` where the model has no mass matrix or
/// joints rest too much.
pub(crate) fn forward(m: &Material<'_>, proof: &Proof<'_>, bare: Option<Bare<'_>>) -> Option<Forward> {
    if m.base.measured_load {
        // The drive train alone moves nothing.
        return None;
    }
    let scene = proof.scene;
    let state = &m.selection.state;
    let on = |model: &Model, state: &crate::search::State| -> Raw {
        let fitted = Fitted { base: m.base, model, state };
        Transferred::new(scene, m.search.families, &m.search.limits, fitted).torque(state)
    };
    let with = on(&m.selection.model, state);
    let without = match bare {
        Some(b) => on(b.model, b.state),
        None => m.base.on(scene).nominal,
    };
    let plant = Plant::of(m);
    let mut sums = vec![[0.0; 2]; scene.joints];
    let mut windows = 0;
    for (p, piece) in scene.pieces.iter().enumerate() {
        let length = (HORIZON_S * scene.rate_hz).round() as usize;
        for start in (0..piece.len().saturating_sub(length)).step_by(length.max(1)) {
            if !all_move(scene, piece, start, length) {
                continue;
            }
            let ends: Vec<Option<DVector<f64>>> =
                [&without, &with].iter().map(|torque| plant.run(scene, piece, torque.get(p)?, start, length)).collect();
            let [Some(a), Some(b)] = ends.as_slice() else { continue };
            windows += 1;
            for (j, sum) in sums.iter_mut().enumerate() {
                sum[0] += a[j] * a[j];
                sum[1] += b[j] * b[j];
            }
        }
    }
    let rms = |k: usize| sums.iter().map(|s| (s[k] / windows as f64).sqrt()).collect();
    (windows >= LEAST).then(|| Forward { off_rad: rms(0), on_rad: rms(1), windows })
}

/// Whether all joints move through a window: what friction holds a resting joint with is not known.
fn all_move(scene: &Scene, piece: &Piece, start: usize, length: usize) -> bool {
    let row = |k: usize| piece.rows.start + k / scene.stride.max(1);
    (row(start)..=row(start + length).min(piece.rows.end.saturating_sub(1)))
        .all(|r| scene.mask.iter().all(|m| m.get(r) == Some(&true)))
}

/// The model's inertia and damping.
struct Plant {
    body: Box<dyn RigidBody>,
    pi: Vec<f64>,
    /// Inertia that was found beyond the parameters.
    added: Vec<f64>,
    damping: Vec<f64>,
}

impl Plant {
    fn of(m: &Material<'_>) -> Self {
        let (model, state) = (&m.selection.model, &m.selection.state);
        let n = m.scene.joints;
        let (mut added, mut damping) = (vec![0.0; n], vec![0.0; n]);
        for (slot, i) in model.free_base().into_iter().enumerate() {
            if let (Some(BaseRole::Viscous(j)), Some(v)) =
                (model.base.get(i).map(|b| &b.role), state.fit.beta.get(slot))
            {
                damping[*j] = v.max(0.0);
            }
        }
        for (i, atom) in model.atoms.iter().enumerate() {
            let own = matches!(m.search.families[atom.family].id(), "rotor_inertia" | "arm_inertia");
            if let (true, Some(v)) = (own, state.fit.beta.get(model.slots(i).start)) {
                added[atom.joint] += v;
            }
        }
        let pi = if m.base.nominal_base { m.scene.pi.clone() } else { free_parameters(m.scene, model, state) };
        Self { body: m.scene.body.with_gravity([0.0; 3]), pi, added, damping }
    }

    /// Mass matrix at sample `k`, by unit accelerations.
    fn mass(&self, piece: &Piece, k: usize) -> Option<Cholesky<f64, Dyn>> {
        let n = self.added.len();
        let q: Vec<f64> = piece.q.iter().map(|x| x.get(k).copied()).collect::<Option<_>>()?;
        let zero = vec![0.0; n];
        let mut out = DMatrix::zeros(n, n);
        for j in 0..n {
            let (mut unit, mut tau) = (zero.clone(), zero.clone());
            unit[j] = 1.0;
            let motion = Motion { q_rad: &q, qd_rad_s: &zero, qdd_rad_s2: &unit };
            self.body.torque(&motion, &self.pi, &mut tau).ok()?;
            tau[j] += self.added[j];
            out.set_column(j, &DVector::from_vec(tau));
        }
        Cholesky::new((&out + out.transpose()) * 0.5)
    }

    /// Deviation at the end of a window; `torque` is the model's along the piece.
    fn run(
        &self,
        scene: &Scene,
        piece: &Piece,
        torque: &[Vec<f64>],
        start: usize,
        length: usize,
    ) -> Option<DVector<f64>> {
        let n = self.added.len();
        let dt = 1.0 / scene.rate_hz;
        let keep = ((KEEP_S * scene.rate_hz).round() as usize).max(1);
        let (mut e, mut v) = (DVector::zeros(n), DVector::<f64>::zeros(n));
        let mut mass = self.mass(piece, start)?;
        for k in start..start + length {
            if (k - start) % keep == keep - 1 {
                mass = self.mass(piece, k)?;
            }
            let mut force = DVector::zeros(n);
            for j in 0..n {
                let model = torque.get(j).and_then(|t| t.get(k)).copied().unwrap_or(0.0);
                force[j] = piece.tau[j].get(k)? - model - self.damping[j] * v[j];
            }
            v += mass.solve(&force) * dt;
            e += &v * dt;
        }
        Some(e)
    }
}
