use std::sync::Arc;

use plc_api::handlers::with;
use plc_api::units::{Bar, KiloNewton, Whole};
use plc_api::{Alarm, AuxOutput, CoordinateSystem, MCode, Params, Plc, SequenceProgram, HandlerState, Va, Vb};

const CLAMP: MCode = MCode::new(12, "clamp");
const OPEN: MCode = MCode::new(13, "open");
const BLOW: MCode = MCode::new(14, "blow");
const TURN: MCode = MCode::new(15, "turn");

plc_api::unit!(
    /// A flow.
    pub struct LitrePerMinute, "l/min"
);

const LOWEST: f64 = 0.5;

#[derive(Params)]
struct Blow {
    /// How much.
    #[va(LOWEST..=6.5, "bar", name = "air pressure")]
    pressure: f64,
    #[vb]
    flow: LitrePerMinute<0, 40>,
    #[vh(-3..)]
    r#loop: Option<i16>,
}

#[derive(Params)]
struct Nothing {}

async fn clamp(Va(force): Va<KiloNewton<1, 20>>, HandlerState(cell): HandlerState<Arc<str>>, plc: Plc) -> Result<(), Alarm> {
    let _: (f64, Arc<str>, Plc) = (force.0, cell, plc);
    Ok(())
}

async fn open() -> Result<(), Alarm> {
    Ok(())
}

async fn blow(output: AuxOutput, blow: Blow, system: CoordinateSystem) -> Result<(), Alarm> {
    let _: (f64, f64, Option<i16>) = (blow.pressure, blow.flow.0, blow.r#loop);
    let _ = (output, system);
    Ok(())
}

async fn turn(Va(_to): Va<Option<Whole>>, Vb(_with): Vb<Bar>, _: Plc) -> Result<(), Alarm> {
    Ok(())
}

async fn of_number(_output: AuxOutput) -> Result<(), Alarm> {
    Ok(())
}

async fn shared(_output: AuxOutput, _plc: Plc, _state: Arc<str>) -> Result<(), Alarm> {
    Ok(())
}

fn main() {
    let state: Arc<str> = "cell".into();
    let program = SequenceProgram::new()
        .on(CLAMP, clamp)
        .state(Arc::clone(&state))
        .on(OPEN, open)
        .on(BLOW, blow)
        .in_coordinate_system(2, |cs| cs.on(TURN, turn).on([BLOW, OPEN], |_: Nothing| async { Ok(()) }))
        .on(MCode::new(16, "both"), with(state, shared))
        // handlers without named M codes, in the form of version 0.1
        .on(20, of_number)
        .on(21..=22, |_output| async { Ok(()) })
        .on([23, 24], |_output, _plc| async { Ok(()) })
        .on(25..27, move |output| of_number(output))
        .on(27, with((), |_output, _plc, ()| async { Ok(()) }))
        .validate(CLAMP, |_params| Ok(()))
        .validate(20, |_params| Ok(()));
    assert_eq!(program.check(), Ok(()));
}
