//! Stored values that are damaged, and therefore unknown. Every use of such a value is rejected until a
//! person writes it again.

/// Mark of a lost value: a NaN whose bits no calculation produces and no interface accepts.
pub const LOST: f64 = f64::from_bits(0x7ffc_4c4f_5354_2121);

/// Returns true if the value is [`LOST`].
#[inline]
pub fn is_lost(value: f64) -> bool {
    value.to_bits() == LOST.to_bits()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_lost_value_is_lost() {
        assert!(is_lost(LOST) && LOST.is_nan());
        for value in [0.0, f64::NAN, -f64::NAN, f64::INFINITY] {
            assert!(!is_lost(value));
        }
    }
}
