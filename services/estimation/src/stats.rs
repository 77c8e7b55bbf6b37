//! Robust statistics: median, median absolute deviation, quantiles, the normal distribution.
//!
//! | symbol | meaning |
//! |---|---|
//! | MAD | median of abs(x − median(x)) |
//! | 1.4826 | 1/Φ⁻¹(3/4): makes the MAD the standard deviation of a normal sample |

/// 1/Φ⁻¹(3/4), with which the MAD estimates the standard deviation of a normal sample.
pub const MAD_TO_SD: f64 = 1.482_602_218_505_602;

/// Median of `x` (mean of the middle two for an even count), reordering it; NaN for an empty slice.
/// NaN entries sort above everything.
pub fn median_in_place(x: &mut [f64]) -> f64 {
    quantile_in_place(x, 0.5)
}

/// Median of `x`; NaN for an empty slice.
pub fn median(x: &[f64]) -> f64 {
    median_in_place(&mut x.to_vec())
}

/// Median absolute deviation from the median (not scaled; times [`MAD_TO_SD`] it estimates a standard deviation).
pub fn mad(x: &[f64]) -> f64 {
    let mut work = x.to_vec();
    let centre = median_in_place(&mut work);
    for v in &mut work {
        *v = (*v - centre).abs();
    }
    median_in_place(&mut work)
}

/// Quantile `p` in 0..=1 of `x` by linear interpolation between order statistics (Hyndman and Fan's type 7,
/// the default of numpy and R), reordering `x`; NaN for an empty slice or a `p` outside 0..=1.
pub fn quantile_in_place(x: &mut [f64], p: f64) -> f64 {
    if x.is_empty() || !(0.0..=1.0).contains(&p) {
        return f64::NAN;
    }
    let position = p * (x.len() - 1) as f64;
    let low = (position.floor() as usize).min(x.len() - 1);
    let share = position - low as f64;
    let (_, &mut at, above) = x.select_nth_unstable_by(low, f64::total_cmp);
    if share <= 0.0 || above.is_empty() {
        return at;
    }
    let next = above.iter().copied().fold(f64::INFINITY, f64::min);
    at + share * (next - at)
}

/// Quantile `p` of `x`; see [`quantile_in_place`].
pub fn quantile(x: &[f64], p: f64) -> f64 {
    quantile_in_place(&mut x.to_vec(), p)
}

/// Arithmetic mean; NaN for an empty slice.
pub fn mean(x: &[f64]) -> f64 {
    x.iter().sum::<f64>() / x.len() as f64
}

/// Root mean square; NaN for an empty slice.
pub fn rms(x: &[f64]) -> f64 {
    (x.iter().map(|v| v * v).sum::<f64>() / x.len() as f64).sqrt()
}

/// Standard deviation about the mean with n − 1; NaN for fewer than two values.
pub fn standard_deviation(x: &[f64]) -> f64 {
    if x.len() < 2 {
        return f64::NAN;
    }
    let m = mean(x);
    (x.iter().map(|v| (v - m) * (v - m)).sum::<f64>() / (x.len() - 1) as f64).sqrt()
}

/// Quantile Φ⁻¹(p) of the standard normal distribution, to about 1e-15 relative: Wichura's algorithm AS 241
/// (PPND16), Applied Statistics 37 (1988) 477-484. ±∞ at 0 and 1, NaN outside 0..=1.
pub fn normal_quantile(p: f64) -> f64 {
    if !(0.0..=1.0).contains(&p) {
        return f64::NAN;
    }
    let q = p - 0.5;
    if q.abs() <= 0.425 {
        let r = 0.180_625 - q * q;
        return q * ratio(&A, &B, r);
    }
    let tail = if q < 0.0 { p } else { 1.0 - p };
    if tail <= 0.0 {
        return if q < 0.0 { f64::NEG_INFINITY } else { f64::INFINITY };
    }
    let r = (-tail.ln()).sqrt();
    let z = if r <= 5.0 { ratio(&C, &D, r - 1.6) } else { ratio(&E, &F, r - 5.0) };
    if q < 0.0 { -z } else { z }
}

fn ratio(numerator: &[f64; 8], denominator: &[f64; 8], r: f64) -> f64 {
    let horner = |c: &[f64; 8]| c.iter().rev().fold(0.0, |sum, &a| sum * r + a);
    horner(numerator) / horner(denominator)
}

// Coefficients of AS 241, lowest power first.
const A: [f64; 8] = [
    3.387_132_872_796_366_5,
    1.331_416_678_917_843_8e2,
    1.971_590_950_306_551_3e3,
    1.373_169_376_550_946e4,
    4.592_195_393_154_987e4,
    6.726_577_092_700_87e4,
    3.343_057_558_358_813e4,
    2.509_080_928_730_122_7e3,
];
const B: [f64; 8] = [
    1.0,
    4.231_333_070_160_091e1,
    6.871_870_074_920_579e2,
    5.394_196_021_424_751e3,
    2.121_379_430_158_659_7e4,
    3.930_789_580_009_271e4,
    2.872_908_573_572_194_3e4,
    5.226_495_278_852_545e3,
];
const C: [f64; 8] = [
    1.423_437_110_749_683_5,
    4.630_337_846_156_546,
    5.769_497_221_460_691,
    3.647_848_324_763_204_5,
    1.270_458_252_452_368_4,
    2.417_807_251_774_506e-1,
    2.272_384_498_926_918_4e-2,
    7.745_450_142_783_414e-4,
];
const D: [f64; 8] = [
    1.0,
    2.053_191_626_637_759,
    1.676_384_830_183_803_8,
    6.897_673_349_851e-1,
    1.481_039_764_274_800_8e-1,
    1.519_866_656_361_645_7e-2,
    5.475_938_084_995_345e-4,
    1.050_750_071_644_416_9e-9,
];
const E: [f64; 8] = [
    6.657_904_643_501_103,
    5.463_784_911_164_114,
    1.784_826_539_917_291_3,
    2.965_605_718_285_048_7e-1,
    2.653_218_952_657_612_4e-2,
    1.242_660_947_388_078_4e-3,
    2.711_555_568_743_487_6e-5,
    2.010_334_399_292_288_1e-7,
];
const F: [f64; 8] = [
    1.0,
    5.998_322_065_558_88e-1,
    1.369_298_809_227_358e-1,
    1.487_536_129_085_061_5e-2,
    7.868_691_311_456_133e-4,
    1.846_318_317_510_054_8e-5,
    1.421_511_758_316_446e-7,
    2.044_263_103_389_939_8e-15,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_statistics_by_hand() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), 2.5);
        assert_eq!(mad(&[1.0, 1.0, 2.0, 2.0, 4.0, 6.0, 9.0]), 1.0);
        // numpy.quantile([7, 1, 3, 10], 0.9) = 9.1
        assert!((quantile(&[7.0, 1.0, 3.0, 10.0], 0.9) - 9.1).abs() < 1e-14);
        assert_eq!(quantile(&[7.0, 1.0], 1.0), 7.0);
        assert!(median(&[]).is_nan() && quantile(&[1.0], 1.5).is_nan());
        assert!((standard_deviation(&[1.0, 2.0, 3.0, 4.0]) - 1.290_994_448_735_805_6).abs() < 1e-15);
    }

    #[test]
    fn normal_quantiles_against_published_values() {
        // Wichura's own check values (AS 241, section "Accuracy") and the tables' 97.5 % point.
        for (p, z) in [
            (0.25, -0.674_489_750_196_081_7),
            (0.001, -3.090_232_306_167_813_5),
            (1e-20, -9.262_340_089_798_408),
            (0.975, 1.959_963_984_540_054),
            (0.5, 0.0),
        ] {
            assert!((normal_quantile(p) - z).abs() < 1e-14 * (1.0 + f64::abs(z)), "{p}: {}", normal_quantile(p));
        }
        assert_eq!(normal_quantile(1.0), f64::INFINITY);
        assert!(normal_quantile(-0.1).is_nan());
        assert!((MAD_TO_SD * normal_quantile(0.75) - 1.0).abs() < 1e-15);
    }
}
