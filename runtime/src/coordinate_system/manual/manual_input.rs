//! Manual data input (MDI) and homing: short NC programs without a number, after which the state is READY.
//!
//! Each input is a separate run, and its text is checked before the run. Its modal state stays for the next input.
//! After a program, homing, a stop, an alarm or a reset, an input begins in the start-up modal state instead. A macro
//! is an input that reads its numbers in the unit of the settings and as positions, regardless of earlier inputs.
//! However the macro ends (except by a reset), the runtime then restores the modal state that was in force before.

use std::collections::BTreeMap;
use std::sync::Arc;

use plc_protocol::types::request::{Refusal, RefusalCode};
use tandem_interp::meaning::Role;
use tandem_model::limits::MDI_BYTES_MAX;
use tandem_model::{Axis, AxisSet};
use tandem_store::program_store::StoredProgram;

use crate::coordinate_system::CoordinateSystem;
use crate::coordinate_system::run::active_run::{
    ActiveRun, ActiveRunKind, AtRest, Restores, SingleBlockState,
};

impl CoordinateSystem {
    /// Prepares a run of manual data input with one or several lines. For a macro, keeps the current state, which is
    /// restored when the macro ends.
    pub(crate) fn prepare_manual(
        &self,
        text: &str,
        is_macro: bool,
    ) -> Result<(String, Option<ActiveRun>), Refusal> {
        if !self.context.shared.machine.takes_mdi {
            let text = "this machine runs signed programs only, and manual data input is not signed; write \
                        a signed \
                        program, or set mdi = true in [programs]";
            return Err(Refusal::new(RefusalCode::NotSigned, text));
        }
        if text.len() > MDI_BYTES_MAX {
            let text = format!(
                "the text has {} bytes; at most {MDI_BYTES_MAX} are read",
                text.len()
            );
            return Err(Refusal::new(RefusalCode::TooLarge, text));
        }
        // The end of the program is added to the text, so an input needs no M02 or M30.
        let (note, mut run) = self.prepare_text(ActiveRunKind::Manual, text, self.past.manual_goes_on)?;
        if let Some(run) = run.as_mut().filter(|_| is_macro) {
            run.restores = Some(Box::new(Restores {
                in_force: self.pipeline.in_force_at_rest(),
                manual_goes_on: self.past.manual_goes_on,
            }));
        }
        Ok((note, run))
    }

    /// Restores and publishes the state that was in force before a macro. Called when the macro has ended.
    pub(crate) fn restore_after_macro(&mut self, restores: Restores) {
        self.pipeline.restore(restores.in_force, self.servo.epoch());
        self.past.manual_goes_on = restores.manual_goes_on;
        let transform = self.pipeline.in_force.transform;
        self.context.view.update(|place| place.transform = transform);
        self.publish_modal(&self.pipeline.in_force.modal);
    }

    /// Prepares a run of a text and adds the end of the program (such as M30) to the text.
    fn prepare_text(
        &self,
        kind: ActiveRunKind,
        text: &str,
        in_modal: bool,
    ) -> Result<(String, Option<ActiveRun>), Refusal> {
        let end = self.context.configured.dialect.m_code(Role::End);
        let text = format!("{text}\n{}\n", end.map_or("", |code| code.code));
        let program = StoredProgram::manual(&text, self.context.configured.text_rules(), in_modal);
        let program = Arc::new(program);
        let warning = self.context.check_called(&program)?;
        Ok((
            warning,
            Some(self.new_run(kind, program, &self.context.shared.store.all())),
        ))
    }

    /// Prepares a run that moves the motors of these axes to their first reference points, all at the same time.
    pub(crate) fn prepare_home(&self, axes: &[char]) -> Result<(String, Option<ActiveRun>), Refusal> {
        let dialect = self.context.configured.dialect;
        let named = axes.iter().map(|axis| self.axis_of(*axis));
        let mut axes: Vec<Axis> = named.collect::<Result<_, _>>()?;
        if let Some(code) = dialect.home_code().filter(|code| code.role == Role::ToReference) {
            if axes.is_empty() {
                let all = self.context.configured.settings.axes();
                axes = all.iter().filter(|axis| code.takes(*axis)).collect();
            }
            if let Some(axis) = axes.iter().find(|axis| !code.takes(**axis)) {
                let (letter, code, name) = (axis.letter(), code.code, dialect.name);
                let text = format!("axis {letter}: {code} of dialect {name} does not move it; jog it");
                return Err(Refusal::new(RefusalCode::Invalid, text));
            }
        }
        // The middle point of the homing block is the current position: distance 0 of each axis.
        let words: Vec<String> = axes.iter().map(|axis| format!("{}0", axis.letter())).collect();
        let text = format!("{} {}", dialect.home, words.join(" "));
        self.prepare_text(ActiveRunKind::Home, &text, false)
    }

    pub(crate) fn axis_of(&self, letter: char) -> Result<Axis, Refusal> {
        let axes = self.context.configured.settings.axes();
        Axis::from_letter(letter.to_ascii_uppercase())
            .filter(|axis| axes.contains(*axis))
            .ok_or_else(|| {
                let text = format!("there is no axis {letter}; there are {}", letters(axes));
                Refusal::new(RefusalCode::Invalid, text)
            })
    }

    /// Creates a run of a program, with the current texts of all programs in the store.
    pub(crate) fn new_run(
        &self,
        kind: ActiveRunKind,
        main: Arc<StoredProgram>,
        all: &BTreeMap<u16, Arc<StoredProgram>>,
    ) -> ActiveRun {
        let (mut programs, mut refused) = (BTreeMap::new(), self.context.shared.store.damaged());
        for (number, program) in all {
            match self.context.refuses(program) {
                Some(refusal) => drop(refused.insert(*number, refusal.text)),
                None => drop(programs.insert(*number, Arc::clone(&program.tree))),
            }
        }
        if main.number != 0 {
            // the validated text, even if the store now has another text
            programs.insert(main.number, Arc::clone(&main.tree));
        }
        ActiveRun {
            id: self.next_run_id(),
            kind,
            main,
            programs,
            conditions: None,
            refused,
            first_segment: self.pipeline.planner.last_segment() + 1,
            from: self.pipeline.path.position().0,
            restores: None,
            missed_touch: None,
            steps: SingleBlockState::default(),
            at_rest: AtRest::default(),
            arrival: None,
        }
    }
}

fn letters(axes: AxisSet) -> String {
    let letters: Vec<String> = axes.iter().map(|axis| axis.letter().to_string()).collect();
    letters.join(", ")
}
