//! From a time step to the numbers of filter and smoother. Nothing here sees a measurement: joints of equal
//! noise ratio q/r share one [`Gains`], and steps that repeat share one [`Step`]. Covariances are in units of r.

use super::model::{carried, process_covariance, process_shape, transition};
use super::small::{
    Matrix, Vector, apply, cholesky, congruence, congruence_plus, identity, inverse, product, right_divide,
    symmetrised, transposed,
};
use super::{CovarianceUpdate, Noise, PRIOR_SD, Settings};

/// Largest change of P between two equal steps, relative to its diagonal, that counts as converged.
const CONVERGED: f64 = 1e-12;
/// P this close to the converged one is taken for it.
const BACK_AT_STEADY: f64 = 1e-11;
/// The predicted position is never taken for less certain than √this measurement standard deviations: beyond,
/// a measurement replaces the prediction all the same, and the covariance would lose the digits to say more.
const LEAST_CERTAIN: f64 = 1e11;
/// Noise ratios that differ by less are equal but for rounding.
const SAME_RATIO: f64 = 1e-12;
/// Smallest relative Cholesky pivot at which the information of the first samples is inverted.
const DETERMINED: f64 = 1e-9;

/// What the smoother needs of the step k → k + 1: x_k given all = a_k + C x_{k+1}, P_k = A + C P_{k+1} Cᵀ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Back<const N: usize> {
    /// Smoother gain C.
    pub c: Matrix<N>,
    /// Covariance A of x_k if x_{k+1} were known.
    pub a: Matrix<N>,
}

/// Everything about the step k → k + 1 that does not depend on the data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step<const N: usize> {
    pub back: Back<N>,
    /// Filter gain K: x ← F x + K (z − θ⁻).
    pub k: Vector<N>,
    /// Variance S/r of the innovation z − θ⁻; 0 while the state is not determined, see [`Information`].
    pub s: f64,
}

impl<const N: usize> Step<N> {
    /// False for the steps between the first samples, which go by [`Information`].
    #[inline]
    pub fn determined(&self) -> bool {
        self.s > 0.0
    }
}

/// The forward step between the first samples: a_k = A η, η ← `map` η + Hᵀ z, and once the state is
/// determined, x = `ready` η.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Information<const N: usize> {
    pub map: Matrix<N>,
    pub ready: Option<Matrix<N>>,
}

/// What is known at the newest sample.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Knowledge<const N: usize> {
    /// Information matrix Λ of the first `samples`, singular at first.
    Information { lambda: Matrix<N>, samples: usize },
    /// Covariance P.
    Covariance(Matrix<N>),
}

/// Which steps count as equal. One per smoother, for all joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Period {
    tolerance: f64,
    period: f64,
    last: f64,
}

impl Period {
    pub fn new(settings: &Settings) -> Self {
        Self::repeating(if settings.steady_state { settings.period_tolerance } else { -1.0 })
    }

    /// Steps that differ by less than the fraction `tolerance` are equal; below zero none are.
    pub fn repeating(tolerance: f64) -> Self {
        Self { tolerance, period: f64::NAN, last: f64::NAN }
    }

    /// The step whose gains `dt` uses, and whether it is the period's. Two equal steps make a new period.
    #[inline]
    pub fn classify(&mut self, dt: f64) -> (f64, bool) {
        let near = |reference: f64| (dt - reference).abs() <= self.tolerance * reference;
        if near(self.period) {
            self.last = dt;
            return (self.period, true);
        }
        let repeated = near(self.last);
        self.last = dt;
        if repeated {
            self.period = dt;
        }
        (dt, repeated)
    }
}

/// The covariance recursion of all joints of one noise ratio, for r = 1.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Gains<const N: usize> {
    q_shape: Matrix<N>,
    update: CovarianceUpdate,
    knowledge: Knowledge<N>,
    /// The newest step.
    step: Step<N>,
    /// Its forward part while the state is not determined.
    information: Information<N>,
    /// Converged step for `steady_dt`, with its covariance.
    steady: Option<(Step<N>, Matrix<N>)>,
    steady_dt: f64,
    /// True while `step` is the converged one.
    at_steady: bool,
    /// Counts the converged steps found.
    steady_version: u64,
}

impl<const N: usize> Gains<N> {
    pub fn new(ratio: f64, update: CovarianceUpdate) -> Self {
        let zero = [[0.0; N]; N];
        let nothing = Step { back: Back { c: zero, a: zero }, k: [0.0; N], s: 0.0 };
        let mut gains = Self {
            q_shape: process_shape(ratio),
            update,
            knowledge: Knowledge::Information { lambda: zero, samples: 0 },
            step: nothing,
            information: Information { map: zero, ready: None },
            steady: None,
            steady_dt: f64::NAN,
            at_steady: false,
            steady_version: 0,
        };
        gains.start();
        gains
    }

    /// The first sample of a stretch: only its position is known.
    pub fn start(&mut self) {
        let mut lambda = [[0.0; N]; N];
        lambda[0][0] = 1.0;
        self.knowledge = Knowledge::Information { lambda, samples: 1 };
        self.at_steady = false;
    }

    /// Covariance P of the newest filtered state; `None` while the first samples do not determine it.
    pub fn covariance(&self) -> Option<&Matrix<N>> {
        match &self.knowledge {
            Knowledge::Covariance(p) => Some(p),
            Knowledge::Information { .. } => None,
        }
    }

    /// True while steps repeat and the newest step is the converged one.
    pub fn at_steady(&self) -> bool {
        self.at_steady
    }

    /// Changes whenever another step becomes the converged one.
    pub fn steady_version(&self) -> u64 {
        self.steady_version
    }

    /// The newest step.
    pub fn step(&self) -> &Step<N> {
        &self.step
    }

    /// The newest step's forward part, if the state was not determined before it.
    pub fn information(&self) -> &Information<N> {
        &self.information
    }

    /// Goes on by `dt` (as classified by [`Period`]) and returns the step's numbers.
    #[inline]
    pub fn advance(&mut self, (dt, regular): (f64, bool)) -> &Step<N> {
        if !(self.at_steady && regular && dt == self.steady_dt) {
            self.advance_exactly(dt, regular);
        }
        &self.step
    }

    fn advance_exactly(&mut self, dt: f64, regular: bool) {
        let f = transition::<N>(dt);
        let q = process_covariance(&self.q_shape, dt);
        self.at_steady = false;
        let p = match self.knowledge {
            Knowledge::Information { lambda, samples } => {
                self.information_step(&lambda, samples, dt, &q);
                return;
            }
            Knowledge::Covariance(p) => p,
        };
        let predicted = congruence_plus(&f, &p, &q);
        let certain = LEAST_CERTAIN / predicted[0][0];
        let next = if certain >= 1.0 {
            self.covariance_step(&p, &f, &q, &predicted)
        } else {
            // A uniform factor leaves the gains as they are.
            let scaled = |m: &Matrix<N>| m.map(|row| row.map(|v| v * certain));
            self.covariance_step(&scaled(&p), &f, &scaled(&q), &scaled(&predicted))
        };
        self.knowledge = Knowledge::Covariance(next);
        if !regular {
            return;
        }
        if dt != self.steady_dt {
            self.steady = None;
            self.steady_dt = dt;
        }
        match &self.steady {
            Some((step, converged)) if close(&next, converged, BACK_AT_STEADY) => {
                self.knowledge = Knowledge::Covariance(*converged);
                self.step = *step;
                self.at_steady = true;
            }
            None if close(&next, &p, CONVERGED) => {
                self.steady = Some((self.step, next));
                self.steady_version += 1;
                self.at_steady = true;
            }
            _ => {}
        }
    }

    /// One exact step of filter and smoother gain; returns the new P.
    fn covariance_step(&mut self, p: &Matrix<N>, f: &Matrix<N>, q: &Matrix<N>, predicted: &Matrix<N>) -> Matrix<N> {
        let pft = product(p, &transposed(f));
        // P⁻ ≥ Q > 0; should rounding ever deny it, the smoother learns nothing from the future here.
        let c = cholesky(predicted, 0.0).map_or([[0.0; N]; N], |l| right_divide(&pft, &l));
        let s = predicted[0][0] + 1.0;
        let k: Vector<N> = std::array::from_fn(|i| predicted[i][0] / s);
        let mut next = *predicted;
        let a = match self.update {
            CovarianceUpdate::Joseph => {
                let mut keep = identity::<N>();
                for i in 0..N {
                    keep[i][0] -= k[i];
                }
                // 1 − K_0 = r/S, without the cancellation.
                keep[0][0] = 1.0 / s;
                let gained: Matrix<N> = std::array::from_fn(|i| std::array::from_fn(|j| k[i] * k[j]));
                next = congruence_plus(&keep, predicted, &gained);
                let cf = product(&c, f);
                let mut rest = identity::<N>();
                for i in 0..N {
                    for j in 0..N {
                        rest[i][j] -= cf[i][j];
                    }
                }
                congruence_plus(&rest, p, &congruence(&c, q))
            }
            CovarianceUpdate::Subtractive => {
                for i in 0..N {
                    for j in i..N {
                        next[i][j] = predicted[i][j] - k[i] * k[j] * s;
                        next[j][i] = next[i][j];
                    }
                }
                let explained = congruence(&c, predicted);
                std::array::from_fn(|i| std::array::from_fn(|j| p[i][j] - explained[i][j]))
            }
        };
        self.step = Step { back: Back { c, a }, k, s };
        next
    }

    /// One step in information form, in which an unknown state is Λ = 0 and not a large number. With
    /// Λ' = F⁻ᵀΛF⁻¹ and W = (I + Λ'Q)⁻¹: Λ⁻ = WΛ', η⁻ = W F⁻ᵀ η, C = F⁻¹Wᵀ, A = C Q F⁻ᵀ.
    fn information_step(&mut self, lambda: &Matrix<N>, samples: usize, dt: f64, q: &Matrix<N>) {
        let back = transition::<N>(-dt);
        let back_t = transposed(&back);
        let drifted = congruence(&back_t, lambda);
        let w = diffusion_factor(&drifted, q);
        // Sums of positive parts: Λ⁻ = WΛ'Wᵀ + (WΛ')Q(WΛ')ᵀ and A = AΛA + CQCᵀ hold for the exact W and A, and
        // keep the results positive where rounding spoils these.
        let carried = product(&w, &drifted);
        let mut next = congruence_plus(&carried, q, &congruence(&w, &drifted));
        next[0][0] += 1.0;
        let c = product(&back, &transposed(&w));
        let a = symmetrised(&product(&product(&c, q), &back_t));
        let a = congruence_plus(&c, q, &congruence(&a, lambda));
        let samples = samples + 1;
        let ready = if samples >= N { cholesky(&next, DETERMINED) } else { None };
        let ready = ready.map(|l| symmetrised(&right_divide(&identity(), &l)));
        self.knowledge = match ready {
            Some(p) => Knowledge::Covariance(p),
            None => Knowledge::Information { lambda: next, samples },
        };
        self.step = Step { back: Back { c, a }, k: [0.0; N], s: 0.0 };
        self.information = Information { map: product(&w, &back_t), ready };
    }
}

/// W = (I + Λ'Q)⁻¹, solved in units in which Q has a unit diagonal.
fn diffusion_factor<const N: usize>(drifted: &Matrix<N>, q: &Matrix<N>) -> Matrix<N> {
    let e: Vector<N> = std::array::from_fn(|i| q[i][i].sqrt());
    let mut m = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..N {
            m[i][j] = f64::from(u8::from(i == j));
            for k in 0..N {
                m[i][j] += e[i] * drifted[i][k] * e[k] * (q[k][j] / (e[k] * e[j]));
            }
        }
    }
    // The eigenvalues of I + Λ'Q are 1 or more, so there is an inverse.
    let w = inverse(&m).unwrap_or_else(identity);
    std::array::from_fn(|i| std::array::from_fn(|j| w[i][j] * e[j] / e[i]))
}

/// True if two covariances agree to `tolerance` of their standard deviations' products.
fn close<const N: usize>(a: &Matrix<N>, b: &Matrix<N>, tolerance: f64) -> bool {
    (0..N).all(|i| (i..N).all(|j| (a[i][j] - b[i][j]).abs() <= tolerance * (b[i][i] * b[j][j]).sqrt()))
}

/// A joint's filtered state: x, or η with the position measured from `origin` while it is not determined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Mean<const N: usize> {
    pub x: Vector<N>,
    pub origin: f64,
}

impl<const N: usize> Mean<N> {
    /// At the first sample: measured from there, η = Hᵀ 0.
    pub fn start(z: f64) -> Self {
        Self { x: [0.0; N], origin: z }
    }

    /// Takes in measurement `z`, `dt` after the last; returns the smoother's a_k (of the sample before).
    #[inline]
    pub fn advance(&mut self, step: &Step<N>, information: &Information<N>, dt: f64, z: f64) -> Vector<N> {
        if step.determined() {
            let predicted = carried(&self.x, dt);
            let drawn = apply(&step.back.c, &predicted);
            let a = std::array::from_fn(|i| self.x[i] - drawn[i]);
            let innovation = z - predicted[0];
            self.x = std::array::from_fn(|i| predicted[i] + step.k[i] * innovation);
            return a;
        }
        let mut a = apply(&step.back.a, &self.x);
        // From positions measured from the origin to absolute ones: x_k = a + C x_{k+1}.
        for i in 0..N {
            a[i] += self.origin * (f64::from(u8::from(i == 0)) - step.back.c[i][0]);
        }
        self.x = apply(&information.map, &self.x);
        self.x[0] += z - self.origin;
        if let Some(p) = &information.ready {
            self.x = apply(p, &self.x);
            self.x[0] += self.origin;
        }
        a
    }
}

/// Standard deviations of θ, θ̇, θ̈ in units of √r. Steps that differ by a factor of a million within a few
/// samples can leave no digit of a variance; what is then not positive is unknown, infinite.
#[inline]
pub(super) fn deviations<const N: usize>(p: &Matrix<N>) -> [f64; 3] {
    std::array::from_fn(|i| if p[i][i] > 0.0 { p[i][i].sqrt() } else { f64::INFINITY })
}

/// A standard deviation of derivative `order` for measurements of standard deviation `sd`, from that in units of √r.
#[inline]
pub(super) fn scaled(unit: f64, order: usize, sd: f64) -> f64 {
    match order {
        _ if unit.is_finite() => unit * sd,
        0 => sd,
        _ => PRIOR_SD[order - 1],
    }
}

/// Joints sorted by noise ratio q/r: fills `groups` with the distinct ratios' gains and `group_of` with each
/// joint's place among them. Does not allocate if both have room for all joints.
pub(super) fn group<const N: usize>(
    noise: &[Noise],
    update: CovarianceUpdate,
    groups: &mut Vec<Gains<N>>,
    group_of: &mut Vec<usize>,
) {
    groups.clear();
    group_of.clear();
    for (j, own) in noise.iter().enumerate() {
        let same = |earlier: &Noise| (earlier.ratio() / own.ratio() - 1.0).abs() < SAME_RATIO;
        let place = match noise[..j].iter().position(same) {
            Some(earlier) => group_of[earlier],
            None => {
                groups.push(Gains::new(own.ratio(), update));
                groups.len() - 1
            }
        };
        group_of.push(place);
    }
}
