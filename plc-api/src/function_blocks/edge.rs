//! Edges: IEC 61131-3, table "Standard edge detection function blocks".

/// `R_TRIG`: the output is on only at the call at which the input has turned on. If the input is on at the
/// first call, this call is an edge, as in the standard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RisingEdge {
    /// Input at the previous call; `M` of the standard.
    was: bool,
    q: bool,
}

impl RisingEdge {
    pub(super) const NEW: Self = Self { was: false, q: false };

    /// Updates the block with the input `CLK`; returns `Q`.
    pub fn update(&mut self, input: bool) -> bool {
        self.q = input && !self.was;
        self.was = input;
        self.q
    }

    /// Returns `Q` of the last call.
    pub fn q(&self) -> bool {
        self.q
    }
}

/// `F_TRIG`: the output is on only at the call at which the input has turned off. If the input is off at the
/// first call, this call is an edge, as in the standard. To ignore this first edge, call `update` once
/// before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FallingEdge {
    /// True if the input was off at the previous call; `M` of the standard.
    was_off: bool,
    q: bool,
}

impl FallingEdge {
    /// Updates the block with the input `CLK`; returns `Q`.
    pub fn update(&mut self, input: bool) -> bool {
        self.q = !input && !self.was_off;
        self.was_off = !input;
        self.q
    }

    /// Returns `Q` of the last call.
    pub fn q(&self) -> bool {
        self.q
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OFF: bool = false;
    const ON: bool = true;

    fn outputs<const N: usize>(update: impl FnMut(bool) -> bool, inputs: [bool; N]) -> [bool; N] {
        inputs.map(update)
    }

    #[test]
    fn r_trig_is_on_for_one_call_after_each_rising_edge() {
        let mut edge = RisingEdge::default();
        let inputs = [OFF, ON, ON, OFF, ON, OFF];
        assert_eq!(
            outputs(|clk| edge.update(clk), inputs),
            [OFF, ON, OFF, OFF, ON, OFF]
        );
        assert!(!edge.q());
    }

    #[test]
    fn r_trig_with_input_on_at_cold_restart_is_on_after_first_call_only() {
        let mut edge = RisingEdge::default();
        assert_eq!(outputs(|clk| edge.update(clk), [ON, ON, ON]), [ON, OFF, OFF]);
    }

    #[test]
    fn f_trig_is_on_for_one_call_after_each_falling_edge() {
        let mut edge = FallingEdge::default();
        let inputs = [ON, ON, OFF, OFF, ON, OFF];
        assert_eq!(
            outputs(|clk| edge.update(clk), inputs),
            [OFF, OFF, ON, OFF, OFF, ON]
        );
        assert!(edge.q());
    }

    #[test]
    fn f_trig_with_input_off_at_cold_restart_is_on_after_first_call_only() {
        let mut edge = FallingEdge::default();
        assert_eq!(outputs(|clk| edge.update(clk), [OFF, OFF, OFF]), [ON, OFF, OFF]);
    }
}
