//! Bisection of an interval.

/// Returns the ends of an interval after this number of halvings. If `below` is true for the middle, the
/// lower end moves to the middle, otherwise the upper end does.
#[inline]
pub fn bisect([mut low, mut high]: [f64; 2], halvings: u32, below: impl Fn(f64) -> bool) -> [f64; 2] {
    for _ in 0..halvings {
        let middle = f64::midpoint(low, high);
        if below(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    [low, high]
}
