//! M codes that are on for a scan program.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};

use plc_protocol::alarm::Alarm;
use plc_protocol::lock::lock;
use plc_protocol::types::CoordinateSystemNumber;
use tokio::sync::{oneshot, watch};

use super::scan_question::ScanQuestion;
use crate::handlers::AuxOutput;

/// Key of a flag: coordinate system and M number.
pub(super) type FlagKey = (CoordinateSystemNumber, u16);

/// Sequence numbers of the outputs that were on in an image, by coordinate system and M number.
pub(super) type ShownSeqs = BTreeMap<FlagKey, u64>;

/// Outputs that are on, each with the channel for the answer of the scan.
#[derive(Clone, Default)]
pub(crate) struct Flags(Arc<Mutex<Vec<Flag>>>);

struct Flag {
    output: AuxOutput,
    answer: oneshot::Sender<std::result::Result<(), Alarm>>,
    question: watch::Sender<Option<ScanQuestion>>,
    /// A question that the operator has answered, with the chosen answer.
    operator_answer: Option<(ScanQuestion, String)>,
}

/// Answers of operators with their questions, by coordinate system and M number.
pub(super) type OperatorAnswers = BTreeMap<FlagKey, (ScanQuestion, String)>;

fn key(output: &AuxOutput) -> (CoordinateSystemNumber, u64) {
    (output.coordinate_system(), output.seq())
}

impl Flags {
    /// Handles an output of a scan program: keeps the output on until a scan answers, and returns this
    /// answer.
    pub(crate) async fn on(self, output: AuxOutput) -> std::result::Result<(), Alarm> {
        let (answer, mut answered) = oneshot::channel();
        let (question, mut asked) = watch::channel(None);
        lock(&self.0).push(Flag {
            output: output.clone(),
            answer,
            question,
            operator_answer: None,
        });
        loop {
            let asks = asked.borrow_and_update().clone();
            tokio::select! {
                biased;
                answer = &mut answered => match answer {
                    Ok(answer) => return answer,
                    // the scan program has ended, and this future will be dropped
                    Err(_) => std::future::pending().await,
                },
                Ok(()) = asked.changed() => {}
                () = self.ask_operator(&output, asks) => {}
            }
        }
    }

    /// Asks the operator and stores the answer. Never completes; a drop of the future withdraws the question.
    async fn ask_operator(&self, output: &AuxOutput, asks: Option<ScanQuestion>) {
        if let Some(asked) = asks {
            match output.ask(&*asked.text, &asked.choices).await {
                Ok(choice) => {
                    let mut flags = lock(&self.0);
                    if let Some(flag) = flags.iter_mut().find(|flag| key(&flag.output) == key(output)) {
                        flag.operator_answer = Some((asked, choice));
                    }
                }
                // the output has ended, and its question with it
                Err(error) => {
                    tracing::debug!(%error, m = output.m(), "a question of a scan program has no answer");
                }
            }
        }
        std::future::pending::<()>().await;
    }

    /// Asks this question about an output of the image from now on; `None` withdraws the current question.
    pub(super) fn ask(&self, output: &AuxOutput, asks: Option<ScanQuestion>) {
        let mut flags = self.on_now();
        let Some(flag) = flags.iter_mut().find(|flag| key(&flag.output) == key(output)) else {
            return;
        };
        flag.operator_answer
            .take_if(|(of, _)| Some(&*of) != asks.as_ref());
        flag.question.send_if_modified(|question| {
            let is_new = *question != asks;
            *question = asks;
            is_new
        });
    }

    /// Returns the answers of operators to questions about these outputs.
    pub(super) fn operator_answers(&self, shown: &BTreeMap<FlagKey, AuxOutput>) -> OperatorAnswers {
        let mut said = OperatorAnswers::new();
        for flag in lock(&self.0).iter() {
            let place = (flag.output.coordinate_system(), flag.output.m());
            let is_shown = shown
                .get(&place)
                .is_some_and(|output| key(output) == key(&flag.output));
            if let Some(answer) = flag.operator_answer.as_ref().filter(|_| is_shown) {
                said.insert(place, answer.clone());
            }
        }
        said
    }

    /// Returns the outputs that are on, by coordinate system and M number. If several outputs have the same
    /// number, returns the oldest of them. An output that replaces an output of the previous image `before`
    /// is returned only for the next image. Thus the flag is off for one scan.
    pub(super) fn outputs(&self, before: &ShownSeqs) -> BTreeMap<FlagKey, AuxOutput> {
        let mut on = BTreeMap::new();
        for Flag { output, .. } in self.on_now().iter() {
            on.entry((output.coordinate_system(), output.m()))
                .or_insert_with(|| output.clone());
        }
        on.retain(|place, output| before.get(place).is_none_or(|seq| *seq == output.seq()));
        on
    }

    /// Passes the answer of a scan to an output of the image.
    pub(super) fn answer(&self, output: &AuxOutput, how: std::result::Result<(), Alarm>) {
        let mut flags = self.on_now();
        if let Some(place) = flags.iter().position(|flag| key(&flag.output) == key(output)) {
            // if the output was cancelled meanwhile, its receiver is dropped and the answer is ignored
            let _cancelled = flags.remove(place).answer.send(how);
        }
    }

    /// Removes the flags of outputs whose handling has ended, and returns the other flags.
    fn on_now(&self) -> MutexGuard<'_, Vec<Flag>> {
        let mut flags = lock(&self.0);
        flags.retain(|flag| !flag.answer.is_closed());
        flags
    }
}
