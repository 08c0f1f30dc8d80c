//! Time from which a program sees values written by a sequence program (D16).

use plc_api::{Alarm, AuxOutput, Execution, Plc, SequenceProgram};
use plc_protocol::types::state::Position;

use crate::support::machine::bench;

/// Sets Q5, P7 and an axis of G54, and answers.
async fn measure(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let system = plc.coordinate_system(output.coordinate_system());
    let failed = |error: plc_api::Error| Alarm::user(1, error.to_string());
    system.variables().set(5, 20.0).await.map_err(failed)?;
    plc.variables().write(7, &[1.0, 2.0]).await.map_err(failed)?;
    system
        .set_work_offset("G54", [("X", 3.0)])
        .await
        .map_err(failed)?;
    Ok(())
}

/// Runs a program whose M150 is answered by [`measure`], to its end.
fn run(program: &'static str) -> (Position, Vec<f64>) {
    let bench = bench("").serve(SequenceProgram::new().on(150, measure));
    let played = bench.subprogram(500, program).play(async |scene, _| {
        let system = scene.cs(1);
        system.load(500).await.unwrap();
        system.start().await.unwrap();
        system.wait_until(Execution::ProgramCompleted).await.unwrap();
        let position = system.position().await.unwrap();
        let q = system.variables().read(0, 10).await.unwrap();
        (position, q)
    });
    played.unwrap()
}

#[test]
fn d16_values_written_by_a_handler_before_its_reset_reach_next_block() {
    let (position, _) = run("Q1=Q5\nG01 X1 F6000\nM150\nG54 G01 X[Q5] Y[P8]\nQ2=P7+P8\nM30\n");
    // X: 20 and the new offset 3; Y: 2 and the offset 20 of the configuration, which was not named
    assert_eq!((position.machine["X"], position.machine["Y"]), (23.0, 22.0));
}

#[test]
fn a_sequence_program_reads_what_a_program_wrote() {
    let (_, q) = run("Q1=Q5\nM150\nQ2=Q5\nQ3=P7+P8\nM30\n");
    assert_eq!(q[..4], [0.0, 0.0, 20.0, 3.0]);
}
