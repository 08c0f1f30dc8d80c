//! Questions to the operator: a handler asks, panels show the question with its output, and any operator
//! answers.

use std::future::ready;
use std::sync::Arc;

use plc_protocol::error::{Error, Result};
use plc_protocol::hub::Filter;
use plc_protocol::names::unique_name;
use plc_protocol::port::BoxFuture;
use plc_protocol::types::BootId;
use plc_protocol::types::message::Message;
use plc_protocol::types::output::{HandshakeStatus, PendingOutput};
use plc_protocol::types::question::{Ask, OperatorAnswer, Question};
use plc_protocol::types::refusal::{Refusal, RefusalCode};
use plc_protocol::types::request::typed::{self, AnswerQuestion};
use plc_protocol::types::topic::{CsTopic, Topic};

use crate::claim::{RETRY, accepted};
use crate::coordinate_system::CoordinateSystem;
use crate::handler_session::open_outputs;
use crate::handlers::AuxOutput;
use crate::plc::Plc;

impl AuxOutput {
    /// Asks the operator a question, and waits for one of the choices. Panels show the question with the
    /// output; the question ends with the output. Several questions are asked one after the other. If the
    /// future is dropped, the question is withdrawn.
    ///
    /// `text` has 1 to 200 characters; there are 1 to 8 different choices of 1 to 40 characters.
    ///
    /// ```
    /// # use plc_api::{Alarm, AuxOutput, Params, SequenceProgram, fake::{FakePort, OutputOutcome}};
    /// async fn measure(output: AuxOutput) -> Result<(), Alarm> {
    ///     match output.ask("Is the part clean?", ["yes", "no"]).await?.as_str() {
    ///         "yes" => Ok(()),
    ///         _ => Err(Alarm::user(3, "the operator says that the part is not clean")),
    ///     }
    /// }
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = FakePort::new([1]);
    /// # let plc = fake.plc();
    /// # tokio::spawn(async move { SequenceProgram::new().on(80, measure).run(&plc).await });
    /// # let seq = fake.issue_output(1, 80, Params::default());
    /// // in a panel or a test
    /// let mill = fake.plc().coordinate_system(1);
    /// let asked = mill.question().await?;
    /// assert_eq!(asked.question.text, "Is the part clean?");
    /// mill.answer(&asked, "yes").await?;
    /// # fake.settle().await;
    /// # assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Fails if the text or the choices are out of range, or the handler no longer owns the output.
    pub async fn ask<C: Into<String>>(
        &self,
        text: impl Into<String>,
        choices: impl IntoIterator<Item = C>,
    ) -> Result<String> {
        let ask = Ask {
            boot_id: self.key().boot_id.clone(),
            seq: self.seq(),
            handler_id: self.by().id(),
            instance: Some(self.by().instance()),
            question_id: unique_name("question"),
            text: text.into(),
            choices: choices.into_iter().map(Into::into).collect(),
        };
        if ask.choices.is_empty() {
            return Err(Refusal::new(RefusalCode::Invalid, "a question needs a choice").into());
        }
        ask.check()?;
        let _turn = self.lock_question().await;
        let question = PendingQuestion {
            output: self,
            ask,
            is_answered: false,
        };
        question.answer().await
    }
}

impl Plc {
    /// Asks the operator a question about the output of the calling handler, as [`AuxOutput::ask`] does.
    ///
    /// # Errors
    /// Fails as [`AuxOutput::ask`], and if the caller is not the task of a handler, for example if it is a
    /// task that a handler has spawned.
    #[deprecated(
        since = "0.2.0",
        note = "a question belongs to an output: call `ask` of the `AuxOutput` that the handler was given"
    )]
    pub async fn ask<C: Into<String>>(
        &self,
        text: impl Into<String>,
        choices: impl IntoIterator<Item = C>,
    ) -> Result<String> {
        let is_of_this = |output: &AuxOutput| Arc::ptr_eq(output.plc().port(), self.port());
        let Some(output) = AuxOutput::at_work().filter(is_of_this) else {
            let text = "a question belongs to an output: ask by the AuxOutput that the handler was given";
            return Err(Refusal::new(RefusalCode::Invalid, text).into());
        };
        output.ask(text, choices).await
    }
}

/// A pending question; dropping it before its answer withdraws the question.
struct PendingQuestion<'a> {
    output: &'a AuxOutput,
    ask: Ask,
    is_answered: bool,
}

impl PendingQuestion<'_> {
    async fn answer(mut self) -> Result<String> {
        let plc = self.output.plc();
        let topic = Topic::cs(self.output.coordinate_system(), CsTopic::Pending);
        let mut pending = plc.port().subscribe(Filter::Topics(vec![topic]));
        let mut seen = false;
        let mut ask_at: BoxFuture<'_, ()> = Box::pin(ready(()));
        loop {
            tokio::select! {
                biased;
                message = pending.next() => {
                    let message = message.ok_or(Error::Closed)?;
                    let Some(output) = self.shown_in(&message) else {
                        return Err(self.ended().await);
                    };
                    match output.question.as_ref().filter(|question| question.id == self.ask.question_id) {
                        Some(Question { answer: Some(choice), .. }) => {
                            self.is_answered = true;
                            return Ok(choice.clone());
                        }
                        None if seen => {
                            // the question was lost with the claim
                            seen = false;
                            ask_at = Box::pin(ready(()));
                        }
                        question => seen = question.is_some(),
                    }
                }
                () = &mut ask_at, if !seen => {
                    self.send_question().await?;
                    ask_at = Box::pin(plc.sleep(RETRY));
                }
            }
        }
    }

    /// Sends the question once.
    ///
    /// # Errors
    /// Fails if the machine refuses the question permanently, or the handler no longer owns the output.
    async fn send_question(&self) -> Result<()> {
        match self.output.plc().request(self.request(self.ask.clone())).await {
            Ok(answer) => match accepted(self.output.m(), self.output.seq(), answer) {
                // the claim was lost with the connection: the next `pending` message shows the new state of the
                // output
                Ok(())
                | Err(Error::Handshake {
                    status: HandshakeStatus::NotOwner,
                    ..
                }) => Ok(()),
                Err(Error::Handshake { .. }) => Err(self.ended().await),
                Err(error) => Err(error),
            },
            Err(Error::NoAnswer { .. }) => Ok(()),
            Err(Error::Refused(refusal)) if refusal.code.may_pass() => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Waits until the output is cancelled or has ended, and returns the error for an output that the handler
    /// no longer owns.
    async fn ended(&self) -> Error {
        self.output.cancellation().ended().await;
        Error::Handshake {
            m: self.output.m(),
            seq: self.output.seq(),
            status: HandshakeStatus::Stale,
        }
    }

    fn request(&self, ask: Ask) -> typed::Ask {
        typed::Ask(self.output.coordinate_system(), Some(self.output.m()), ask)
    }

    /// Returns the output of this question from a `pending` message; `None` if the output is no longer open,
    /// or another handler owns the output.
    fn shown_in<'m>(&self, message: &'m Message) -> Option<&'m PendingOutput> {
        let mut outputs = open_outputs(message).iter();
        let open = outputs.find(|output| output.output.seq == self.output.seq());
        let is_ours = |output: &&PendingOutput| {
            let owner = output.handler_id.as_deref();
            owner.is_none_or(|owner| owner == &*self.output.by().handler_id)
        };
        open.filter(is_ours)
            .filter(|_| message.boot_id == self.output.key().boot_id)
    }
}

impl Drop for PendingQuestion<'_> {
    fn drop(&mut self) {
        if self.is_answered {
            return;
        }
        let back = Ask {
            text: String::new(),
            choices: Vec::new(),
            ..self.ask.clone()
        };
        self.output
            .plc()
            .send_without_waiting(self.request(back), "a question was not withdrawn");
    }
}

/// A question that waits for its answer, with its output.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenQuestion {
    /// Boot that issued the output.
    pub boot_id: BootId,
    /// M number.
    pub m: u16,
    /// Sequence number of the output.
    pub seq: u64,
    /// The question.
    pub question: Question,
}

impl CoordinateSystem {
    /// Returns the pending questions, in the order of their outputs.
    ///
    /// # Errors
    /// Fails if the coordinate system does not exist.
    pub async fn questions(&self) -> Result<Vec<OpenQuestion>> {
        let boot_id = self.plc().port().boot_id();
        Ok(open_questions(&boot_id, &self.pending().await?.outputs))
    }

    /// Waits until a question is pending, and returns it; if several are pending, returns the first.
    ///
    /// # Errors
    /// Fails if the machine has ended the connection.
    pub async fn question(&self) -> Result<OpenQuestion> {
        let topic = Topic::cs(self.number(), CsTopic::Pending);
        let mut pending = self.plc().port().subscribe(Filter::Topics(vec![topic]));
        while let Some(message) = pending.next().await {
            let asked = open_questions(&message.boot_id, open_outputs(&message));
            if let Some(first) = asked.into_iter().next() {
                return Ok(first);
            }
        }
        Err(Error::Closed)
    }

    /// Answers a question with one of its choices.
    ///
    /// # Errors
    /// Fails if `choice` is not a choice of the question, or if the question has been answered or withdrawn.
    /// Over MQTT, an error is reported only for an invalid choice.
    pub async fn answer(&self, asked: &OpenQuestion, choice: impl Into<String>) -> Result<()> {
        let choice = choice.into();
        if !asked.question.choices.contains(&choice) {
            let text = format!("{choice:?} is not one of {:?}", asked.question.choices);
            return Err(Refusal::new(RefusalCode::Invalid, text).into());
        }
        let answer = OperatorAnswer {
            boot_id: asked.boot_id.clone(),
            seq: asked.seq,
            question_id: asked.question.id.clone(),
            choice,
            client_id: Some(self.plc().client_id().to_owned()),
        };
        let request = AnswerQuestion(self.number(), Some(asked.m), answer);
        accepted(asked.m, asked.seq, self.plc().request(request).await?)
    }
}

fn open_questions(boot_id: &BootId, outputs: &[PendingOutput]) -> Vec<OpenQuestion> {
    let open = outputs.iter().filter_map(|output| {
        let question = output
            .question
            .as_ref()
            .filter(|question| question.answer.is_none())?;
        Some(OpenQuestion {
            boot_id: boot_id.clone(),
            m: output.output.m,
            seq: output.output.seq,
            question: question.clone(),
        })
    });
    open.collect()
}
