//! Tests of inputs and outputs of the plant in simulated time.

use plc_api::scan::Image;
use plc_protocol::types::io::{IoDeclaration, IoPoint};

use super::*;

/// Returns a machine with a valve and a flow switch, which follows the valve after half a second.
fn plant(program: SequenceProgram) -> Bench {
    Bench::new()
        .declare_io(IoPoint::output("valve"), IoDeclaration::new(false))
        .declare_io(IoPoint::input("flows"), IoDeclaration::new(false))
        .serve(program)
        .plant(|scene| async move {
            let mut opens = scene.plc().io_out("valve").changes();
            opens.next().await; // closed at first
            while let Some(open) = opens.next().await {
                scene.plc().sleep(Duration::from_millis(500)).await;
                scene.plc().io_in("flows").set(open).await?;
            }
            Ok(())
        })
}

async fn coolant(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let on = output.m() == 8;
    plc.io_out("valve").set(on).await?;
    plc.io_in("flows").wait_until(|value| value == on).await?;
    Ok(())
}

fn took_half_a_second(run: &Run, m: u16) {
    let took_s = run.output(m).unwrap().took_s().unwrap();
    assert!((took_s - 0.5).abs() < 0.02, "{took_s}");
}

#[test]
fn a_handler_waits_for_the_input_with_which_the_plant_answers_its_output() {
    let program = SequenceProgram::new().on([8, 9], coolant);
    let run = plant(program)
        .run("M08\nG04 X1\nM09\nM30")
        .unwrap()
        .completed()
        .unwrap();
    took_half_a_second(&run, 8);
    took_half_a_second(&run, 9);
}

#[test]
fn a_scan_does_the_same_in_its_image() {
    let scan = |image: &mut Image| {
        image.set_io_out(
            "valve",
            image.is_on(1, 8) || (image.io_out("valve").is_on() && !image.is_on(1, 9)),
        );
        let flows = image.io_in("flows").is_on();
        if flows {
            image.reset(1, 8);
        } else {
            image.reset(1, 9);
        }
    };
    let program = SequenceProgram::new().scan([8, 9], Duration::from_millis(10), scan);
    let run = plant(program)
        .run("M08\nG04 X1\nM09\nM30")
        .unwrap()
        .completed()
        .unwrap();
    took_half_a_second(&run, 8);
    took_half_a_second(&run, 9);
}

#[test]
fn what_an_operator_forces_in_a_test_is_what_the_program_reads() {
    let program = SequenceProgram::new().on([8, 9], coolant);
    let run = plant(program)
        .at_output(
            8,
            |scene| async move { scene.plc().io_in("flows").force(true).await },
        )
        .run("M08\nM30")
        .unwrap()
        .completed()
        .unwrap();
    assert!(run.output(8).unwrap().took_s().unwrap() < 0.1);
}

#[test]
fn a_run_with_a_plant_repeats_exactly() {
    let run = || {
        let program = SequenceProgram::new().on([8, 9], coolant);
        let run = plant(program)
            .run("G01 X5 F600\nM08\nX0\nM09\nM30")
            .unwrap()
            .completed()
            .unwrap();
        (run.time_s.to_bits(), run.order(1).join("; "))
    };
    assert_eq!(run(), run());
}
