//! Motion whose acceleration is linear in distance: `s'' = b + c s`.
//!
//! With the speed w at the start, the distance is `w sinh(k t)/k + b (cosh(k t) - 1)/k^2` for `c = k^2`. For `c = -k^2`,
//! sine and cosine replace the hyperbolic functions.

/// Largest `|c| t^2` for which the functions are power series.
const SERIES_MAX: f64 = 1e-2;

/// Returns `sinh(k t)/k` and `(cosh(k t) - 1)/k^2` for `c = k^2`, or `sin(k t)/k` and `(1 - cos(k t))/k^2` for `c = -k^2`.
pub fn integrals(c: f64, time_s: f64) -> [f64; 2] {
    let z = c * time_s * time_s;
    if z.abs() < SERIES_MAX {
        let first = 1.0 + z / 6.0 * (1.0 + z / 20.0 * (1.0 + z / 42.0 * (1.0 + z / 72.0)));
        let second = 1.0 + z / 12.0 * (1.0 + z / 30.0 * (1.0 + z / 56.0 * (1.0 + z / 90.0)));
        return [time_s * first, time_s * time_s / 2.0 * second];
    }
    let k = c.abs().sqrt();
    let [first, half] = if c > 0.0 {
        [(k * time_s).sinh(), (k * time_s / 2.0).sinh()]
    } else {
        [(k * time_s).sin(), (k * time_s / 2.0).sin()]
    };
    [first / k, 2.0 * half * half / (k * k)]
}

/// Returns the time in which a distance h is covered, with the speeds w0 and w1 at its ends: `2/k artanh(k h/(w0 + w1))` for
/// `c = k^2`, and `2/k arctan(k h/(w0 + w1))` for `c = -k^2`.
pub fn duration([from, to]: [f64; 2], c: f64, distance: f64) -> f64 {
    let ratio = distance / (from + to);
    let z = c * ratio * ratio;
    let factor = if z.abs() < SERIES_MAX {
        // The sum of z^n/(2 n + 1)
        (0..=8)
            .rev()
            .fold(0.0, |sum, n| sum * z + 1.0 / f64::from(2 * n + 1))
    } else if z > 0.0 {
        let k = z.min(1.0 - f64::EPSILON).sqrt();
        k.atanh() / k
    } else {
        let k = (-z).sqrt();
        k.atan() / k
    };
    2.0 * ratio * factor
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_and_duration_are_inverse_to_each_other() {
        for c in [-400.0, -1.0, -1e-3, 0.0, 1e-3, 1.0, 400.0] {
            for [w, b] in [[1.0, 0.0], [0.2, 3.0], [2.0, -5.0]] {
                let time_s = 0.05;
                let [first, second] = integrals(c, time_s);
                let distance = w * first + b * second;
                let end = (w * w + distance * (2.0 * b + c * distance)).sqrt();
                let found = duration([w, end], c, distance);
                assert!((found - time_s).abs() < 1e-13, "{c} {w} {b}: {found}");
            }
        }
    }

    #[test]
    fn the_series_continue_the_closed_forms() {
        for c in [-1.0, 1.0] {
            let time_s = (SERIES_MAX * (1.0 - 1e-9)).sqrt();
            let k = time_s;
            let [first, second] = integrals(c, time_s);
            let expected = if c > 0.0 {
                [k.sinh(), k.cosh() - 1.0]
            } else {
                [k.sin(), 1.0 - k.cos()]
            };
            assert!((first - expected[0]).abs() < 1e-15);
            assert!((second - expected[1]).abs() < 1e-15);
        }
    }
}
