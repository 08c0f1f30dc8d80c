//! A question to the operator belongs to an output, is shown with the output, and ends with the output.

use plc_api::fake::FakePort;
use plc_api::fake::OutputOutcome;
use plc_api::{Alarm, AuxOutput, CancelReason, Error, Params, Plc, SequenceProgram};
use plc_protocol::types::output::HandshakeStatus;
use plc_protocol::types::question::{Ask, OperatorAnswer};
use plc_protocol::types::request::{RefusalCode, typed};

use crate::{ms, serve};

async fn measure(output: AuxOutput) -> Result<(), Alarm> {
    let answer = output.ask("Is the part clean?", ["yes", "no"]).await?;
    if answer == "yes" {
        Ok(())
    } else {
        Err(Alarm::user(3, answer))
    }
}

fn program() -> SequenceProgram {
    SequenceProgram::new().on(80, measure).handler_id("h")
}

#[tokio::test]
async fn question_stays_pending_until_answered_with_one_of_its_choices() {
    let fake = FakePort::new([1]);
    let _task = serve(&fake, program()).await;
    let seq = fake.issue_output(1, 80, Params::default());
    fake.settle().await;
    let shown = fake.pending(1)[0].question.clone().unwrap();
    assert_eq!(shown.text, "Is the part clean?");
    assert_eq!(shown.choices, ["yes", "no"]);
    let mill = fake.plc().coordinate_system(1);
    let asked = mill.question().await.unwrap();
    assert_eq!((asked.m, asked.seq), (80, seq));
    let Err(Error::Refused(refusal)) = mill.answer(&asked, "maybe").await else {
        panic!("an invalid choice was accepted");
    };
    assert_eq!(refusal.code, RefusalCode::Invalid);
    assert_eq!(fake.closed(1, seq), None);
    mill.answer(&asked, "no").await.unwrap();
    fake.settle().await;
    let alarm = Alarm::user(3, "no");
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Failed { alarm }));
    assert_eq!(mill.questions().await.unwrap(), []);
}

#[tokio::test]
async fn a_question_ends_with_its_output() {
    let fake = FakePort::new([1]);
    let _task = serve(&fake, program()).await;
    fake.issue_output(1, 80, Params::default());
    fake.settle().await;
    let mill = fake.plc().coordinate_system(1);
    let asked = mill.question().await.unwrap();
    fake.cancel(1, CancelReason::Stop);
    fake.settle().await;
    assert_eq!(mill.questions().await.unwrap(), []);
    let Err(Error::Handshake { status, .. }) = mill.answer(&asked, "yes").await else {
        panic!("an answer to a cancelled output was accepted");
    };
    assert_eq!(status, HandshakeStatus::Stale);
}

#[tokio::test]
async fn dropped_question_is_withdrawn_and_the_next_waits_for_its_turn() {
    async fn two(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
        tokio::select! {
            answer = output.ask("Go on?", ["yes"]) => { answer?; }
            () = plc.sleep(ms(500)) => {}
        }
        plc.sleep(ms(500)).await;
        let (first, second) = tokio::join!(output.ask("First?", ["1"]), output.ask("Second?", ["2"]));
        assert_eq!((first?.as_str(), second?.as_str()), ("1", "2"));
        Ok(())
    }
    let fake = FakePort::new([1]);
    let _task = serve(&fake, SequenceProgram::new().on(80, two)).await;
    let seq = fake.issue_output(1, 80, Params::default());
    let mill = fake.plc().coordinate_system(1);
    assert_eq!(mill.question().await.unwrap().question.text, "Go on?");
    fake.advance(ms(600)).await;
    assert_eq!(fake.pending(1)[0].question, None);
    fake.advance(ms(500)).await;
    for (text, choice) in [("First?", "1"), ("Second?", "2")] {
        let asked = mill.question().await.unwrap();
        assert_eq!(asked.question.text, text);
        mill.answer(&asked, choice).await.unwrap();
        fake.settle().await;
    }
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
}

#[tokio::test]
async fn a_lost_handler_asks_no_more_and_only_the_owner_asks() {
    let fake = FakePort::new([1]);
    let task = serve(&fake, program()).await;
    let seq = fake.issue_output(1, 80, Params::default());
    fake.settle().await;
    let boot_id = fake.plc().port().boot_id();
    let ask = |handler_id: &str| Ask {
        boot_id: boot_id.clone(),
        seq,
        handler_id: handler_id.into(),
        question_id: "q".into(),
        text: "Really?".into(),
        choices: vec!["yes".into()],
        instance: None,
    };
    let status = async |request: typed::Ask| fake.plc().port().ask(request).await.unwrap().unwrap().status;
    assert_eq!(
        status(typed::Ask(1, Some(80), ask("other"))).await,
        HandshakeStatus::NotOwner
    );
    task.abort();
    fake.settle().await;
    assert!(fake.pending(1)[0].lost && fake.pending(1)[0].question.is_none());
    assert_eq!(
        status(typed::Ask(1, Some(80), ask("h"))).await,
        HandshakeStatus::NotOwner
    );
}

#[tokio::test]
async fn a_handler_that_lost_only_its_connection_asks_again() {
    let fake = FakePort::new([1]);
    let _task = serve(&fake, SequenceProgram::new().on(80, measure).handler_id("h")).await;
    let seq = fake.issue_output(1, 80, Params::default());
    fake.settle().await;
    let mill = fake.plc().coordinate_system(1);
    let before = mill.question().await.unwrap();
    fake.disconnect_handler("h");
    fake.settle().await;
    fake.advance(ms(2000)).await;
    assert_eq!(fake.closed(1, seq), None, "it waits for its answer as before");
    let asked = mill
        .questions()
        .await
        .unwrap()
        .pop()
        .expect("the question is asked again");
    assert_eq!(asked.question.text, before.question.text);
    mill.answer(&asked, "yes").await.unwrap();
    fake.settle().await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
}

#[tokio::test]
async fn an_answer_counts_once_and_names_question_and_choice() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().on(80, async |output: AuxOutput| {
        let _asked = output.ask("Go on?", ["yes"]).await;
        output.ask("And now?", ["yes", "no"]).await?;
        Ok(())
    });
    let _task = serve(&fake, program).await;
    let seq = fake.issue_output(1, 80, Params::default());
    fake.settle().await;
    let plc = fake.plc();
    let asked = plc.coordinate_system(1).question().await.unwrap();
    let answer = async |question_id: &str, choice: &str| {
        let answer = OperatorAnswer {
            boot_id: asked.boot_id.clone(),
            seq,
            question_id: question_id.into(),
            choice: choice.into(),
            client_id: None,
        };
        let answered = plc.port().ask(typed::AnswerQuestion(1, None, answer)).await;
        answered.unwrap().unwrap().status
    };
    let id = asked.question.id.as_str();
    assert_eq!(answer(id, "no").await, HandshakeStatus::Unknown);
    assert_eq!(answer("another", "yes").await, HandshakeStatus::Unknown);
    assert_eq!(answer(id, "yes").await, HandshakeStatus::Accepted);
    assert_eq!(answer(id, "yes").await, HandshakeStatus::Duplicate);
    fake.settle().await;
    // the late answer to the first question is not an answer to the second question
    assert_eq!(answer(id, "yes").await, HandshakeStatus::Unknown);
    assert_eq!(fake.closed(1, seq), None);
}

#[tokio::test]
async fn what_is_out_of_the_limits_of_a_panel_is_refused_at_the_handler() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().on(80, async |output: AuxOutput| {
        let nine: Vec<String> = (0..9).map(|choice| choice.to_string()).collect();
        let long = "x".repeat(201);
        for refused in [
            output.ask("Go on?", nine).await,
            output.ask("Go on?", Vec::<String>::new()).await,
            output.ask("Go on?", ["yes", "yes"]).await,
            output.ask("Go on?", [""]).await,
            output.ask(long, ["yes"]).await,
        ] {
            assert!(matches!(refused, Err(Error::Refused(refusal)) if refusal.code == RefusalCode::Invalid));
        }
        Ok(())
    });
    let _task = serve(&fake, program).await;
    let seq = fake.issue_output(1, 80, Params::default());
    fake.settle().await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
}

#[tokio::test]
#[expect(deprecated, reason = "the deprecated function still works")]
async fn a_question_to_the_machine_is_one_about_the_output_whose_handler_asks() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().on(80..=81, async |output: AuxOutput, plc: Plc| {
        plc.sleep(ms(10)).await;
        let text = format!("Is M{} good?", output.m());
        plc.ask(text, ["yes"]).await?;
        Ok(())
    });
    let _task = serve(&fake, program).await;
    let seqs = [80, 81].map(|m| fake.issue_output(1, m, Params::default()));
    fake.advance(ms(20)).await;
    let mill = fake.plc().coordinate_system(1);
    for (asked, (m, seq)) in mill
        .questions()
        .await
        .unwrap()
        .iter()
        .zip([80, 81].into_iter().zip(seqs))
    {
        assert_eq!((asked.m, asked.seq), (m, seq));
        assert_eq!(asked.question.text, format!("Is M{m} good?"));
        mill.answer(asked, "yes").await.unwrap();
    }
    fake.settle().await;
    assert_eq!(
        seqs.map(|seq| fake.closed(1, seq)),
        [Some(OutputOutcome::Reset), Some(OutputOutcome::Reset)]
    );
}

#[tokio::test]
#[expect(deprecated, reason = "the deprecated function still works")]
async fn a_question_to_the_machine_outside_of_its_handlers_is_refused() {
    let (fake, other) = (FakePort::new([1]), FakePort::new([1]).plc());
    let refused = fake.plc().ask("Go on?", ["yes"]).await;
    assert!(matches!(refused, Err(Error::Refused(refusal)) if refusal.code == RefusalCode::Invalid));
    let program = SequenceProgram::new().on(80, move |_output: AuxOutput| {
        let other = other.clone();
        async move {
            other
                .ask("Go on?", ["yes"])
                .await
                .map(|_| ())
                .map_err(Alarm::from)
        }
    });
    let _task = serve(&fake, program).await;
    let seq = fake.issue_output(1, 80, Params::default());
    fake.settle().await;
    assert!(matches!(fake.closed(1, seq), Some(OutputOutcome::Failed { .. })));
}
