//! Least squares against closed forms and simulated truth.

use lacuna_estimation::EstimationError;
use lacuna_estimation::least_squares::{
    BlockSums, Gram, Loss, Pivoting, RANK_TOLERANCE, Statistics, Tsqr, accumulate, bartlett_bandwidth, base_parameters,
    least_squares, newey_west, robust,
};
use lacuna_estimation::stats::normal_quantile;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

fn normal(rng: &mut Pcg64Mcg) -> f64 {
    normal_quantile(rng.random_range(1e-15..1.0))
}

fn rows_of(x: &DMatrix<f64>) -> Vec<f64> {
    x.transpose().as_slice().to_vec()
}

#[test]
fn line_through_four_points() {
    // y = 3.5 + 1.4 x through (1, 6), (2, 5), (3, 7), (4, 10); residuals 1.1, −1.3, −0.7, 0.9.
    let x = DMatrix::from_row_slice(4, 2, &[1.0, 1.0, 1.0, 2.0, 1.0, 3.0, 1.0, 4.0]);
    let fit = least_squares(&x, &DVector::from_vec(vec![6.0, 5.0, 7.0, 10.0])).unwrap();
    assert!((fit.beta[0] - 3.5).abs() < 1e-14 && (fit.beta[1] - 1.4).abs() < 1e-14);
    assert!((fit.residual_sum - 4.2).abs() < 1e-13);
    // var(slope) = σ²/Σ(x − x̄)² = 2.1/5
    assert!((fit.covariance[(1, 1)] - 0.42).abs() < 1e-13);
}

#[test]
fn accumulation_does_not_depend_on_threads_or_merging() {
    let blocks = 40;
    let fill = |k: usize, g: &mut Gram| {
        let mut rng = Pcg64Mcg::seed_from_u64(k as u64);
        let x: Vec<f64> = (0..300 * 5).map(|_| normal(&mut rng)).collect();
        let y: Vec<f64> = (0..300).map(|_| normal(&mut rng)).collect();
        g.add_rows(&x, &y, None)
    };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let sums = accumulate::<Gram, EstimationError, _>(blocks, 5, fill).unwrap();
            (sums.total().unwrap(), sums.bootstrap(20, 7).unwrap())
        })
    };
    let (one, four) = (run(1), run(4));
    assert_eq!(one, four, "bit by bit");
    let mut serial = Gram::new(5);
    (0..blocks).for_each(|k| fill(k, &mut serial).unwrap());
    assert!((serial.xtx() - one.0.xtx()).amax() < 1e-9);
    let error =
        accumulate::<Gram, EstimationError, _>(
            9,
            5,
            |k, g| if k > 3 { g.add_rows(&[1.0], &[1.0], None) } else { Ok(()) },
        );
    assert!(error.is_err());
}

#[test]
fn normal_equations_are_refused_where_they_lose_digits() {
    // Two columns that differ by 1e-6 of their length: condition 2e6.
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let x = DMatrix::from_fn(500, 2, |_, _| normal(&mut rng));
    let x = DMatrix::from_fn(500, 2, |i, j| x[(i, 0)] + if j == 1 { 1e-6 * x[(i, 1)] } else { 0.0 });
    let y = DVector::from_fn(500, |i, _| x[(i, 0)] + 3.0 * x[(i, 1)]);
    let (mut gram, mut qr) = (Gram::new(2), Tsqr::new(2));
    gram.add_rows(&rows_of(&x), y.as_slice(), None).unwrap();
    qr.add_rows(&rows_of(&x), y.as_slice(), None).unwrap();
    assert!(matches!(gram.solve(), Err(EstimationError::IllConditioned { condition, .. }) if condition > 1e6));
    let fit = qr.solve().unwrap();
    assert!((fit.beta[0] - 1.0).abs() < 1e-8 && (fit.beta[1] - 3.0).abs() < 1e-8, "{}", fit.beta);
    // Truly dependent, zero, and too few rows: each said in words.
    let twice = DMatrix::from_fn(500, 2, |i, j| x[(i, 0)] * (j + 1) as f64);
    let mut gram = Gram::new(2);
    gram.add_rows(&rows_of(&twice), y.as_slice(), None).unwrap();
    assert!(matches!(gram.solve(), Err(EstimationError::RankDeficient { rank: 1, .. })), "{:?}", gram.solve());
    assert!(matches!(least_squares(&twice, &y), Err(EstimationError::RankDeficient { rank: 1, .. })));
    let zero = DMatrix::from_fn(500, 2, |i, j| if j == 0 { x[(i, 0)] } else { 0.0 });
    assert!(matches!(least_squares(&zero, &y), Err(EstimationError::RankDeficient { rank: 1, .. })));
    assert!(matches!(Gram::new(2).solve(), Err(EstimationError::TooShort { .. })));
}

#[test]
fn folds_and_subsets_need_no_second_pass() {
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let x = DMatrix::from_fn(300, 3, |_, _| normal(&mut rng));
    let y = DVector::from_fn(300, |_, _| normal(&mut rng));
    let block = |range: std::ops::Range<usize>| {
        let mut g = Gram::new(3);
        let part = x.rows(range.start, range.len()).into_owned();
        g.add_rows(&rows_of(&part), &y.as_slice()[range], None).unwrap();
        g
    };
    let sums = BlockSums { blocks: vec![block(0..100), block(100..200), block(200..300)] };
    let left = sums.total().unwrap().without(&sums.blocks[1]).unwrap().select(&[2, 0]).solve().unwrap();
    let keep: Vec<usize> = (0..100).chain(200..300).collect();
    let direct = least_squares(&x.select_rows(&keep).select_columns(&[2, 0]), &y.select_rows(&keep)).unwrap();
    assert!((left.beta - direct.beta).amax() < 1e-12);
    assert_eq!(left.rows, 200);
}

#[test]
fn base_parameters_of_a_known_structure() {
    // Columns: a, b, a + 2b, 0, c, 3c, all of very different units.
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let free = DMatrix::from_fn(200, 3, |_, _| normal(&mut rng));
    let x = DMatrix::from_fn(200, 6, |i, j| {
        let (a, b, c) = (free[(i, 0)], 1e3 * free[(i, 1)], 1e-4 * free[(i, 2)]);
        [a, b, a + 2.0 * b, 0.0, c, 3.0 * c][j]
    });
    let base = base_parameters(&x, RANK_TOLERANCE, Pivoting::InOrder).unwrap();
    assert_eq!((base.independent.as_slice(), base.rank(), base.zero.as_slice()), (&[0, 1, 4][..], 3, &[3][..]));
    let factors: Vec<(usize, Vec<(usize, f64)>)> =
        base.dependent.iter().map(|d| (d.column, d.combination.clone())).collect();
    assert_eq!(factors[0].0, 2);
    let near = |c: &(usize, f64), b: usize, f: f64| c.0 == b && (c.1 / f - 1.0).abs() < 1e-6;
    assert!(near(&factors[0].1[1], 1, 2.0) && near(&factors[1].1[0], 4, 3.0), "{factors:?}");
    assert!(base.condition < 2.0, "{}", base.condition);
    // From R the same, and by largest share as many.
    let mut qr = Tsqr::new(6);
    qr.add_rows(&rows_of(&x), &[0.0; 200], None).unwrap();
    let from_r = base_parameters(&qr.regressor_factor(), RANK_TOLERANCE, Pivoting::InOrder).unwrap();
    assert_eq!(from_r.independent, base.independent);
    assert_eq!(base_parameters(&x, RANK_TOLERANCE, Pivoting::Largest).unwrap().rank(), 3);
    let nothing = base_parameters(&DMatrix::zeros(5, 2), RANK_TOLERANCE, Pivoting::Largest).unwrap();
    assert_eq!((nothing.rank(), nothing.zero.len()), (0, 2));
    assert!(base_parameters(&x, 0.0, Pivoting::Largest).is_err());
}

/// Regression with AR(1) errors and regressors: iid intervals fail, the three robust ones cover.
#[test]
fn robust_intervals_cover_under_autocorrelation() {
    let (runs, n, block) = (300, 2000, 100);
    let mut covered = [0usize; 4];
    for run in 0..runs {
        let mut rng = Pcg64Mcg::seed_from_u64(1000 + run);
        let mut ar = |rho: f64| {
            let mut v = 0.0;
            (0..n)
                .map(|_| {
                    v = rho * v + normal(&mut rng);
                    v
                })
                .collect::<Vec<f64>>()
        };
        let (x1, e) = (ar(0.8), ar(0.8));
        let x = DMatrix::from_fn(n, 2, |i, j| if j == 0 { x1[i] } else { 1.0 });
        let y = DVector::from_fn(n, |i, _| 2.0 * x1[i] + e[i]);
        let fit = least_squares(&x, &y).unwrap();
        let residual = &y - &x * &fit.beta;
        let scores: Vec<f64> = (0..n).map(|i| residual[i] * x1[i]).collect();
        let hac = newey_west(&fit, &x, &y, 2 * bartlett_bandwidth(&scores), &[]).unwrap();
        let sums = accumulate::<Gram, EstimationError, _>(n / block, 2, |k, g| {
            let part = x.rows(k * block, block).into_owned();
            g.add_rows(&rows_of(&part), &y.as_slice()[k * block..(k + 1) * block], None)
        })
        .unwrap();
        let cluster = sums.cluster_covariance(&fit).unwrap();
        let inside = |variance: f64| usize::from((fit.beta[0] - 2.0).abs() < 1.96 * variance.sqrt());
        covered[0] += inside(fit.covariance[(0, 0)]);
        covered[1] += inside(hac[(0, 0)]);
        covered[2] += inside(cluster[(0, 0)]);
        let (low, high) = sums.bootstrap(200, run).unwrap().interval(0, 0.95);
        covered[3] += usize::from(low < 2.0 && 2.0 < high);
    }
    let share = covered.map(|c| c as f64 / runs as f64);
    assert!(share[0] < 0.75, "iid intervals should fail here: {share:?}");
    for s in &share[1..] {
        assert!((0.89..=0.98).contains(s), "{share:?}");
    }
}

#[test]
fn tukey_ignores_gross_outliers() {
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let x = DMatrix::from_fn(400, 2, |_, j| if j == 0 { 1.0 } else { normal(&mut rng) });
    let y = DVector::from_fn(400, |i, _| {
        1.0 - 2.0 * x[(i, 1)] + 0.1 * normal(&mut rng) + if i % 10 == 0 { 50.0 } else { 0.0 }
    });
    let fit = robust(&x, &y, Loss::TUKEY).unwrap();
    assert!(fit.converged && (fit.fit.beta[0] - 1.0).abs() < 0.02 && (fit.fit.beta[1] + 2.0).abs() < 0.02);
    assert!((0..400).step_by(10).all(|i| fit.weights[i] == 0.0));
    assert!((fit.scale / 0.1 - 1.0).abs() < 0.2);
    // An exact fit has nothing to weigh.
    let exact = DVector::from_fn(400, |i, _| x[(i, 1)]);
    assert!(robust(&x, &exact, Loss::HUBER).unwrap().fit.beta[1] > 0.999_999);
    assert!(robust(&x, &y, Loss::Tukey(f64::NAN)).is_err());
}

proptest! {
    /// The fit is equivariant under column scaling and invariant under row order; Gram and QR agree.
    #[test]
    fn fits_are_equivariant(seed in 0u64..10_000, scale in 1e-6..1e6f64) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let x = DMatrix::from_fn(40, 3, |_, _| normal(&mut rng));
        let y = DVector::from_fn(40, |_, _| normal(&mut rng));
        let fit = least_squares(&x, &y).unwrap();
        let mut scaled = x.clone();
        scaled.column_mut(1).scale_mut(scale);
        let other = least_squares(&scaled, &y).unwrap();
        prop_assert!((other.beta[1] * scale - fit.beta[1]).abs() < 1e-9);
        prop_assert!((other.condition / fit.condition - 1.0).abs() < 1e-9);
        let mut gram = Gram::new(3);
        for i in (0..40).rev() {
            let row: Vec<f64> = x.row(i).iter().copied().collect();
            gram.add_rows(&row, &[y[i]], None).unwrap();
        }
        let again = gram.solve().unwrap();
        prop_assert!((again.beta - &fit.beta).amax() < 1e-9);
        // The residual is orthogonal to the columns.
        prop_assert!((x.transpose() * (&y - &x * &fit.beta)).amax() < 1e-9);
    }
}
