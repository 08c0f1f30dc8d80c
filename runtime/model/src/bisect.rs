//! Halving of an interval.

/// Returns the ends of an interval after this number of halvings: its lower end moves to each middle that is
/// `below`, its upper end to any other.
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
