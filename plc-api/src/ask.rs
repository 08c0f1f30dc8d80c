//! Questions to the operator: asked by a handler, shown on panels with its output, answered by anyone who may operate.

use std::sync::Arc;

use crate::coordinate_system::CoordinateSystem;
use crate::error::{Error, Result};
use crate::handlers::{AuxOutput, Cancellation};
use crate::hub::Filter;
use crate::outputs::accepted;
use crate::plc::{Plc, send_without_waiting, unique_name};
use crate::types::message::{Message, Payload};
use crate::types::output::{HandshakeStatus, PendingOutput};
use crate::types::question::{Ask, OperatorAnswer, Question};
use crate::types::request::{Refusal, RefusalCode, Request};
use crate::types::topic::{CsTopic, Topic};
use crate::types::{BootId, CoordinateSystemNumber};

/// How long after a question that has not been seen in `pending` it is sent again.
const RETRY: std::time::Duration = std::time::Duration::from_secs(1);

/// The output that a handler works on, and by which name.
#[derive(Debug)]
pub(crate) struct Asker {
    pub(crate) handler_id: Arc<str>,
    pub(crate) boot_id: BootId,
    pub(crate) cs: CoordinateSystemNumber,
    pub(crate) m: u16,
    pub(crate) seq: u64,
    pub(crate) cancellation: Cancellation,
    /// An output asks one question at a time; the next one waits here.
    pub(crate) turn: tokio::sync::Mutex<()>,
}

impl Plc {
    /// Asks the operator, and waits for one of the choices. Within a handler only: the question belongs to the output
    /// that the handler works on, is shown with it, and ends with it. Of several at a time the first is shown first;
    /// a future that is dropped takes its question back.
    ///
    /// `text` has 1 to 200 characters; there are 1 to 8 choices of 1 to 40 characters, each once.
    ///
    /// ```
    /// # use plc_api::{Alarm, AuxOutput, Params, Plc, SequenceProgram, fake::FakePort, handshake::Closed};
    /// async fn measure(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    ///     match plc.ask("Is the part clean?", ["yes", "no"]).await?.as_str() {
    ///         "yes" => Ok(()),
    ///         _ => Err(Alarm::user(3, "the operator says that the part is not clean")),
    ///     }
    /// }
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = FakePort::new([1]);
    /// # let plc = fake.plc();
    /// # tokio::spawn(async move { SequenceProgram::new().on(80, measure).run(&plc).await });
    /// # let seq = fake.put_out(1, 80, Params::default());
    /// // a panel, or a test
    /// let mill = fake.plc().coordinate_system(1);
    /// let asked = mill.question().await?;
    /// assert_eq!(asked.question.text, "Is the part clean?");
    /// mill.answer(&asked, "yes").await?;
    /// # fake.settle().await;
    /// # assert_eq!(fake.closed(1, seq), Some(Closed::Reset));
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Text or choices are out of their limits, this is not the [`Plc`] that a handler was given, or the output is no
    /// longer the handler's.
    pub async fn ask<C: Into<String>>(
        &self,
        text: impl Into<String>,
        choices: impl IntoIterator<Item = C>,
    ) -> Result<String> {
        let Some(asker) = self.asker() else {
            let text = "a question belongs to an output: ask with the Plc that the handler was given";
            return Err(Refusal::new(RefusalCode::Invalid, text).into());
        };
        let ask = Ask {
            boot_id: asker.boot_id.clone(),
            seq: asker.seq,
            handler_id: asker.handler_id.to_string(),
            question_id: unique_name("question"),
            text: text.into(),
            choices: choices.into_iter().map(Into::into).collect(),
        };
        if ask.choices.is_empty() {
            return Err(Refusal::new(RefusalCode::Invalid, "a question needs a choice").into());
        }
        ask.check()?;
        let _turn = asker.turn.lock().await;
        let question = Asked {
            plc: self,
            asker,
            ask,
        };
        question.answered().await
    }
}

impl AuxOutput {
    /// Asks the operator about this output: [`Plc::ask`].
    ///
    /// # Errors
    /// As [`Plc::ask`].
    pub async fn ask<C: Into<String>>(
        &self,
        text: impl Into<String>,
        choices: impl IntoIterator<Item = C>,
    ) -> Result<String> {
        self.plc().ask(text, choices).await
    }
}

/// A question under way; dropped before its end it is taken back.
struct Asked<'a> {
    plc: &'a Plc,
    asker: &'a Asker,
    ask: Ask,
}

impl Asked<'_> {
    async fn answered(self) -> Result<String> {
        let topic = Topic::cs(self.asker.cs, CsTopic::Pending);
        let mut pending = self.plc.port().subscribe(Filter::Topics(vec![topic]));
        let mut seen = false;
        loop {
            if !seen {
                let request = Request::Ask(self.asker.cs, Some(self.asker.m), self.ask.clone());
                match self.plc.request(request).await {
                    Ok(answer) => match accepted(self.asker.m, self.asker.seq, &answer) {
                        // the connection was lost and the claim given back: `pending` tells how it goes on
                        Ok(())
                        | Err(Error::Handshake {
                            status: HandshakeStatus::NotOwner,
                            ..
                        }) => {}
                        Err(Error::Handshake { .. }) => return Err(self.ended().await),
                        Err(error) => return Err(error),
                    },
                    Err(Error::Refused(refusal)) if refusal.code == RefusalCode::Unavailable => {}
                    Err(error) => return Err(error),
                }
            }
            tokio::select! {
                biased;
                message = pending.next() => {
                    let message = message.ok_or(Error::Closed)?;
                    let Some(output) = self.output(&message) else {
                        return Err(self.ended().await);
                    };
                    match output.question.as_ref().filter(|question| question.id == self.ask.question_id) {
                        Some(Question { answer: Some(choice), .. }) => return Ok(choice.clone()),
                        question => seen = question.is_some(),
                    }
                }
                () = self.plc.sleep(RETRY), if !seen => {}
            }
        }
    }

    /// The output is no longer the handler's. Who drops the handler for that says why first.
    async fn ended(&self) -> Error {
        self.asker.cancellation.ended().await;
        Error::Handshake {
            m: self.asker.m,
            seq: self.asker.seq,
            status: HandshakeStatus::Stale,
        }
    }

    /// The output as `pending` shows it; `None` when it is no longer open, or another's.
    fn output<'m>(&self, message: &'m Message) -> Option<&'m PendingOutput> {
        let Payload::Pending(pending) = &message.payload else {
            return None;
        };
        let mut outputs = pending.outputs.iter();
        let open = outputs.find(|output| output.output.seq == self.asker.seq);
        let is_ours = |output: &&PendingOutput| {
            let owner = output.handler_id.as_deref();
            owner.is_none_or(|owner| owner == &*self.asker.handler_id)
        };
        open.filter(is_ours)
            .filter(|_| message.boot_id == self.asker.boot_id)
    }
}

impl Drop for Asked<'_> {
    fn drop(&mut self) {
        let back = Ask {
            text: String::new(),
            choices: Vec::new(),
            ..self.ask.clone()
        };
        let request = Request::Ask(self.asker.cs, Some(self.asker.m), back);
        send_without_waiting(self.plc, request, "a question was not taken back");
    }
}

/// A question that waits for its answer, and the output that it belongs to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenQuestion {
    /// Boot that made the output.
    pub boot_id: BootId,
    /// M number.
    pub m: u16,
    /// Sequence number of the output.
    pub seq: u64,
    /// What is asked.
    pub question: Question,
}

impl CoordinateSystem {
    /// Questions without an answer, in the order of their outputs.
    ///
    /// # Errors
    /// There is no such coordinate system.
    pub async fn questions(&self) -> Result<Vec<OpenQuestion>> {
        let boot_id = self.plc().port().boot_id();
        Ok(open_questions(&boot_id, &self.pending().await?.outputs))
    }

    /// Waits until a question is asked, and gives the first.
    ///
    /// # Errors
    /// The machine's side ended.
    pub async fn question(&self) -> Result<OpenQuestion> {
        let topic = Topic::cs(self.number(), CsTopic::Pending);
        let mut pending = self.plc().port().subscribe(Filter::Topics(vec![topic]));
        while let Some(message) = pending.next().await {
            if let Payload::Pending(pending) = &message.payload
                && let Some(first) = open_questions(&message.boot_id, &pending.outputs)
                    .into_iter()
                    .next()
            {
                return Ok(first);
            }
        }
        Err(Error::Closed)
    }

    /// Answers a question by one of its choices.
    ///
    /// # Errors
    /// The choice is none of them, the question has an answer, or it is not asked any more. Over MQTT only a choice
    /// that is none of them is known here.
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
        let request = Request::AnswerQuestion(self.number(), Some(asked.m), answer);
        accepted(asked.m, asked.seq, &self.plc().request(request).await?)
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
