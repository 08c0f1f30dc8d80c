use plc_api::{Alarm, MCode, Params, SequenceProgram};

const CLAMP: MCode = MCode::new(12, "clamp");

#[derive(Params)]
struct Clamp {
    #[va]
    force: String,
}

async fn clamp(_clamp: Clamp) -> Result<(), Alarm> {
    Ok(())
}

fn main() {
    let _ = SequenceProgram::new().on(CLAMP, clamp);
}
