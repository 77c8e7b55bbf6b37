//! The motion model over a step dt: a chain of N integrators driven by white noise.

use super::small::{Matrix, Vector};

/// F(dt): F_ij = dt^(j−i)/(j−i)!.
pub(super) fn transition<const N: usize>(dt: f64) -> Matrix<N> {
    let mut term = [1.0; N];
    for m in 1..N {
        term[m] = term[m - 1] * (dt / m as f64);
    }
    std::array::from_fn(|i| std::array::from_fn(|j| if j < i { 0.0 } else { term[j - i] }))
}

/// F(dt) x without the matrix: Taylor's polynomial of each derivative.
#[inline(always)]
pub(super) fn carried<const N: usize>(x: &Vector<N>, dt: f64) -> Vector<N> {
    let mut y = *x;
    for i in 0..N {
        let mut sum = x[N - 1];
        for j in (i..N - 1).rev() {
            sum = x[j] + sum * (dt / (j - i + 1) as f64);
        }
        y[i] = sum;
    }
    y
}

/// The factors of Q(dt) for intensity q: Q_ij = shape_ij dt^(2N−1−i−j).
pub(super) fn process_shape<const N: usize>(q: f64) -> Matrix<N> {
    let factorial = |n: usize| (1..=n).map(|v| v as f64).product::<f64>();
    std::array::from_fn(|i| {
        std::array::from_fn(|j| q / (factorial(N - 1 - i) * factorial(N - 1 - j) * (2 * N - 1 - i - j) as f64))
    })
}

/// Q(dt).
#[inline]
pub(super) fn process_covariance<const N: usize>(shape: &Matrix<N>, dt: f64) -> Matrix<N> {
    // power[m] = dt^(m + 1)
    let mut power = [[dt; N]; 2];
    for m in 1..2 * N {
        power[m / N][m % N] = power[(m - 1) / N][(m - 1) % N] * dt;
    }
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let m = 2 * N - 2 - i - j;
            shape[i][j] * power[m / N][m % N]
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::small::{apply, congruence_plus};

    #[test]
    fn steps_compose() {
        // F(a + b) = F(b) F(a) and Q(a + b) = F(b) Q(a) F(b)ᵀ + Q(b): what any exact discretisation obeys.
        let (a, b) = (0.3, 0.5);
        let shape = process_shape::<4>(2.0);
        let both = congruence_plus(&transition(b), &process_covariance(&shape, a), &process_covariance(&shape, b));
        let whole = process_covariance(&shape, a + b);
        let x = [0.1, -2.0, 3.0, 0.7];
        let there = carried(&carried(&x, a), b);
        let at_once = apply(&transition(a + b), &x);
        for i in 0..4 {
            assert!((there[i] - at_once[i]).abs() < 1e-14);
            for j in 0..4 {
                assert!((both[i][j] / whole[i][j] - 1.0).abs() < 1e-13, "{i} {j}");
            }
        }
        // White snap of intensity 2: the jerk is a random walk of variance 2 dt.
        assert!((whole[3][3] - 1.6).abs() < 1e-15);
    }
}
