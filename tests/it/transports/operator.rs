//! A handler's question to the operator, and its check of parameters at load, each transport.

use std::time::{Duration, Instant};

use plc_api::{Alarm, AuxOutput, Error, Execution, Params, SequenceProgram};
use plc_protocol::types::request::RefusalCode;
use plc_protocol::types::request::typed::Handlers;

use super::{Reached, in_process, over_mosquitto, over_rest, over_the_embedded_broker};
use crate::support::wait::{until, within};

/// The pocket of VA; the magazine ends with 6.
fn pocket(params: &Params) -> Result<f64, Alarm> {
    let pocket = params.a().ok_or(Alarm::user(1, "VA is missing"))?;
    if pocket > 6.0 {
        return Err(Alarm::user(2, format!("there is no pocket {pocket}")));
    }
    Ok(pocket)
}

async fn ask(output: AuxOutput) -> Result<(), Alarm> {
    let pocket = pocket(output.params())?;
    match output
        .ask(format!("Is tool {pocket} in its pocket?"), ["yes", "no"])
        .await?
        .as_str()
    {
        "yes" => Ok(()),
        answer => Err(Alarm::user(3, format!("the operator says {answer}"))),
    }
}

async fn asked_and_validated(reached: &Reached) {
    let plc = reached.plc.clone();
    let serving = plc.clone();
    let program = SequenceProgram::new()
        .on(100, ask)
        .validate(100, pocket)
        .handler_id("asks");
    let handlers = tokio::spawn(async move { program.run(&serving).await });
    until("the handler is known", async || {
        let known = plc.port().ask(Handlers).await.ok()?;
        known
            .get("asks")
            .filter(|handler| handler.online && handler.validates)
            .map(|_| ())
    })
    .await;
    let system = plc.coordinate_system(1);
    // program 50 issues M100 VA7, program 52 VA1 and VA2
    let Err(Error::Refused(refusal)) = within("load 50", system.load(50)).await else {
        panic!("M100 VA7 was not refused");
    };
    assert_eq!(refusal.code, RefusalCode::ProgramHasErrors);
    let begun = Instant::now();
    within("load 52", system.load(52)).await.expect("load");
    assert!(
        begun.elapsed() < Duration::from_millis(1500),
        "the load waited for a handler that has answered: {:?}",
        begun.elapsed()
    );
    within("start", system.start()).await.expect("start");
    for (tool, answer) in [(1, "yes"), (2, "no")] {
        let asked = within("a question", system.question()).await.expect("a question");
        assert_eq!(asked.question.text, format!("Is tool {tool} in its pocket?"));
        let shown = system.wait_for(|state| {
            let waiting = state.waiting_on.as_ref();
            waiting.is_some_and(|waiting| waiting.question.as_deref() == Some(&asked.question))
        });
        let state = within("the question in the state", shown).await.expect("a state");
        assert_eq!(state.execution, Execution::Wait);
        within("answer", system.answer(&asked, answer))
            .await
            .expect("an answer");
        let answered = system.wait_for(|state| {
            state
                .waiting_on
                .as_ref()
                .is_none_or(|waiting| waiting.seq != asked.seq)
        });
        within("the program goes on", answered).await.expect("a state");
    }
    let stopped = system.wait_until(Execution::Stopped);
    within("STOPPED", stopped).await.expect("a state");
    assert!(system.questions().await.expect("pending").is_empty());
    handlers.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn in_process_an_operator_answers_and_parameters_are_checked_at_load() {
    let reached = in_process().await;
    asked_and_validated(&reached).await;
    reached.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn embedded_broker_operator_answers_and_load_checks_parameters() {
    let reached = over_the_embedded_broker().await;
    asked_and_validated(&reached).await;
    reached.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_mosquitto_an_operator_answers_and_parameters_are_checked_at_load() {
    let (reached, _broker) = over_mosquitto().await;
    asked_and_validated(&reached).await;
    reached.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_rest_an_operator_answers_and_parameters_are_checked_at_load() {
    let reached = over_rest().await;
    asked_and_validated(&reached).await;
    reached.end().await;
}
