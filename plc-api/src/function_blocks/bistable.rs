//! Bistable elements: IEC 61131-3, table "Standard bistable function blocks".

/// `SR`: a flag with a set input and a reset input; if both inputs are on, the flag is set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SetDominant {
    q1: bool,
}

impl SetDominant {
    /// Updates the block with the inputs `S1` and `R`; returns `Q1`.
    pub fn update(&mut self, set: bool, reset: bool) -> bool {
        self.q1 = set || (!reset && self.q1);
        self.q1
    }

    /// Returns `Q1` of the last call.
    pub fn q(&self) -> bool {
        self.q1
    }
}

/// `RS`: a flag with a set input and a reset input; if both inputs are on, the flag is reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ResetDominant {
    q1: bool,
}

impl ResetDominant {
    /// Updates the block with the inputs `S` and `R1`; returns `Q1`.
    pub fn update(&mut self, set: bool, reset: bool) -> bool {
        self.q1 = !reset && (set || self.q1);
        self.q1
    }

    /// Returns `Q1` of the last call.
    pub fn q(&self) -> bool {
        self.q1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of the truth table: set, reset, the previous output, and the resulting outputs of SR and of RS.
    const TRUTH: [(bool, bool, bool, bool, bool); 8] = [
        (false, false, false, false, false),
        (false, false, true, true, true),
        (false, true, false, false, false),
        (false, true, true, false, false),
        (true, false, false, true, true),
        (true, false, true, true, true),
        (true, true, false, true, false),
        (true, true, true, true, false),
    ];

    #[test]
    fn sr_and_rs_differ_only_where_both_inputs_are_on() {
        for (set, reset, before, sr, rs) in TRUTH {
            let (mut set_dominant, mut reset_dominant) =
                (SetDominant { q1: before }, ResetDominant { q1: before });
            assert_eq!(
                set_dominant.update(set, reset),
                sr,
                "SR of {set} {reset} {before}"
            );
            assert_eq!(
                reset_dominant.update(set, reset),
                rs,
                "RS of {set} {reset} {before}"
            );
            assert_eq!((set_dominant.q(), reset_dominant.q()), (sr, rs));
        }
    }
}
