//! Numbers as an engineer writes them: significant digits, true minus signs, no noise digits.

/// Stands where a number does not exist (not finite, or not given).
pub const MISSING: &str = "–";

/// `value` with `digits` significant digits: `0.312`, `12 400`, `1.2 × 10⁻⁹`, `−3.1`.
///
/// Plain notation from 10⁻³ up to 10⁶, scientific outside. Non-finite values give [`MISSING`].
#[must_use]
pub fn significant(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return MISSING.to_owned();
    }
    if value == 0.0 {
        return "0".to_owned();
    }
    let digits = digits.clamp(1, 15);
    let (mantissa, exponent) = scientific_parts(value, digits - 1);
    if (-3..6).contains(&exponent) {
        // The exponent after rounding decides: 0.9996 is 1.00 with three digits, not 1.000.
        fixed(value, usize::try_from((digits as i32 - 1 - exponent).max(0)).unwrap_or(0))
    } else {
        format!("{} × 10{}", with_minus(&mantissa), superscript(exponent))
    }
}

/// `value` with a fixed number of decimals, grouped in thousands from 10 000 on.
#[must_use]
pub fn fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return MISSING.to_owned();
    }
    let plain = format!("{value:.decimals$}");
    // "-0.00" says something the digits do not support.
    let plain = if plain.bytes().all(|b| matches!(b, b'-' | b'0' | b'.')) { plain.replace('-', "") } else { plain };
    grouped(&with_minus(&plain))
}

/// A setting as it was given: up to four significant digits, no trailing zeros: `40`, `0.05`, `−0.2`.
#[must_use]
pub fn compact(value: f64) -> String {
    let text = significant(value, 4);
    if text.contains('×') || !text.contains('.') {
        return text;
    }
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Decimals with which all values of a column can be written: two significant digits for the smallest if that
/// takes no more than four of the largest, and at least three of the largest. `None` where no plain notation serves: nothing
/// finite, or a largest value outside 10⁻³ … 10⁶.
#[must_use]
pub fn common_decimals(values: impl IntoIterator<Item = f64>) -> Option<usize> {
    let sizes = values.into_iter().map(f64::abs).filter(|v| v.is_finite() && *v > 0.0);
    let (smallest, largest) = sizes.fold((f64::INFINITY, 0.0), |(a, b), v| (f64::min(a, v), f64::max(b, v)));
    if largest == 0.0 {
        return None;
    }
    let (low, high) = (scientific_parts(smallest, 2).1, scientific_parts(largest, 2).1);
    let wanted = (1 - low).clamp(2 - high, 3 - high);
    (-3..6).contains(&high).then(|| usize::try_from(wanted.max(0)).unwrap_or(0))
}

/// A share as per cent with one decimal: `0.0843` → `8.4 %`.
#[must_use]
pub fn percent(share: f64) -> String {
    let value = share * 100.0;
    if !value.is_finite() {
        return MISSING.to_owned();
    }
    format!("{}\u{202f}%", if value.abs() < 1e6 { fixed(value, 1) } else { significant(value, 3) })
}

/// A value and its interval, rounded to what the interval's width supports (two significant digits of
/// its half-width): `0.1234, [0.1032, 0.1441]` → `("0.123", "0.103 to 0.144")`.
///
/// The second string is [`MISSING`] where the interval has no finite ends.
#[must_use]
pub fn with_interval(value: f64, low: f64, high: f64) -> (String, String) {
    let half = 0.5 * (high - low).abs();
    if !half.is_finite() {
        return (significant(value, 4), MISSING.to_owned());
    }
    let largest = value.abs().max(low.abs()).max(high.abs());
    let (_, exponent) = scientific_parts(if half > 0.0 { half } else { largest * 1e-3 }, 1);
    if largest != 0.0 && !(1e-3..1e6).contains(&largest) {
        let join = |v: f64| significant(v, 3);
        return (join(value), format!("{} to {}", join(low), join(high)));
    }
    let decimals = usize::try_from((1 - exponent).clamp(0, 9)).unwrap_or(0);
    (fixed(value, decimals), format!("{} to {}", fixed(low, decimals), fixed(high, decimals)))
}

/// Splits into mantissa text and exponent, both after rounding.
fn scientific_parts(value: f64, decimals: usize) -> (String, i32) {
    let text = format!("{value:.decimals$e}");
    match text.split_once('e') {
        Some((mantissa, exponent)) => (mantissa.to_owned(), exponent.parse().unwrap_or(0)),
        None => (text, 0),
    }
}

fn with_minus(text: &str) -> String {
    text.replace('-', "\u{2212}")
}

fn grouped(text: &str) -> String {
    let (whole, rest) = text.split_once('.').map_or((text, None), |(w, r)| (w, Some(r)));
    let digits: Vec<char> = whole.chars().filter(char::is_ascii_digit).collect();
    if digits.len() < 5 {
        return text.to_owned();
    }
    let mut out: String = whole.chars().take_while(|c| !c.is_ascii_digit()).collect();
    for (i, digit) in digits.iter().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(*digit);
    }
    if let Some(rest) = rest {
        out.push('.');
        out.push_str(rest);
    }
    out
}

fn superscript(exponent: i32) -> String {
    exponent
        .to_string()
        .chars()
        .map(|c| match c {
            '-' => '⁻',
            '1' => '¹',
            '2' => '²',
            '3' => '³',
            other => other.to_digit(10).and_then(|d| char::from_u32(0x2070 + d)).unwrap_or(other),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn significant_digits() {
        for (value, digits, expected) in [
            (0.31234, 3, "0.312"),
            (0.99963, 3, "1.00"),
            (-3.12345, 2, "−3.1"),
            (123.4, 3, "123"),
            (12_345.6, 3, "12\u{202f}346"),
            (1.23e-9, 2, "1.2 × 10⁻⁹"),
            (2.5e10, 3, "2.50 × 10¹⁰"),
            (0.0, 3, "0"),
            (-0.0, 3, "0"),
            (f64::NAN, 3, MISSING),
            (f64::NEG_INFINITY, 3, MISSING),
        ] {
            assert_eq!(significant(value, digits), expected, "{value}");
        }
    }

    #[test]
    fn intervals_decide_the_digits() {
        assert_eq!(with_interval(0.123_45, 0.1032, 0.1441), ("0.123".into(), "0.103 to 0.144".into()));
        assert_eq!(with_interval(12.3456, 10.0, 14.0), ("12.3".into(), "10.0 to 14.0".into()));
        assert_eq!(with_interval(1.0, f64::NAN, 2.0), ("1.000".into(), MISSING.into()));
        assert_eq!(with_interval(-0.0001, -0.02, 0.02), ("0.000".into(), "−0.020 to 0.020".into()));
        assert_eq!(with_interval(0.0, 0.0, 0.0).0, "0.0");
    }

    #[test]
    fn a_column_shares_its_decimals_and_settings_lose_their_zeros() {
        assert_eq!(common_decimals([0.0713, 0.282, f64::NAN]), Some(3));
        assert_eq!(common_decimals([14.32, -1.09, 5.67]), Some(1));
        assert_eq!(common_decimals([5.0, 0.001]), Some(3));
        assert_eq!(common_decimals([412.0, 37.2]), Some(0));
        assert_eq!(common_decimals([f64::INFINITY, 0.0]), None);
        assert_eq!(common_decimals([1e-9]), None);
        assert_eq!((compact(40.0), compact(0.05), compact(-0.2)), ("40".into(), "0.05".into(), "−0.2".into()));
        assert_eq!(compact(100.0), "100");
    }

    #[test]
    fn percentages() {
        assert_eq!(percent(0.0843), "8.4\u{202f}%");
        assert_eq!(percent(-0.0001), "0.0\u{202f}%");
        assert_eq!(percent(f64::INFINITY), MISSING);
    }

    proptest! {
        /// What is printed lies within half a unit of the last digit of the number itself.
        #[test]
        fn printed_numbers_are_the_numbers(value in -1e5_f64..1e5, digits in 3_usize..8) {
            let text = significant(value, digits);
            prop_assume!(!text.contains('×'));
            let back: f64 = text.replace('\u{2212}', "-").replace('\u{202f}', "").parse().expect("a plain number");
            let scale = 10_f64.powf(value.abs().max(1e-300).log10().floor() - digits as f64 + 1.0);
            prop_assert!((back - value).abs() <= 0.51 * scale.clamp(1e-12, 1.0), "{value} printed as {text}");
        }
    }
}
