//! The conditions from which a plan is made: the state of the machine at that time, or at the start of a run.

use std::collections::{BTreeMap, BTreeSet};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::line_start::LineStart;
use plc_protocol::types::message::Payload;
use plc_protocol::types::state::{CapturedPositions, State};
use plc_protocol::types::topic::{CsTopic, Topic};
use tandem_config::ConfiguredSystem;
use tandem_model::settings::{Tool, WorkOffsets};
use tandem_model::variables::{COORDINATE_SYSTEM_VARIABLES, VariableArray};
use tandem_model::{AXES_MAX, MachinePosition, Variables};
use tandem_store::program_store::{StoredProgram, called_by};
use tandem_syntax::NcProgram;

use crate::coordinate_system::View;
use crate::shared::SharedState;

/// A program with the programs that it may call, and all data that they read.
#[derive(Debug)]
#[expect(clippy::struct_excessive_bools, reason = "each is an input of its own")]
pub(crate) struct Conditions {
    pub main: Arc<StoredProgram>,
    pub programs: BTreeMap<u16, Arc<NcProgram>>,
    pub texts: BTreeMap<u16, Arc<StoredProgram>>,
    pub configured: ConfiguredSystem,
    pub at: MachinePosition,
    pub tool: Option<u16>,
    pub tools: BTreeMap<u16, Tool>,
    pub work_offsets: WorkOffsets,
    pub optional_skip: u32,
    pub optional_stop: bool,
    pub dry_run: bool,
    /// Single block ends each block at rest, without blending into the next one.
    pub single_block: bool,
    pub captured: [f64; AXES_MAX],
    /// Copy of the variables, which later writes do not change.
    pub variables: Variables,
    /// True if a program text may read variables.
    pub reads_variables: bool,
    /// The line at which the run begins; `None` for line 1.
    pub from: Option<LineStart>,
    /// Key of all conditions except position and variables. The key changes when any of these conditions changes.
    pub key: u64,
    /// Key of the position, rounded to 1 nm, so that rounding errors of a sum do not change the key.
    pub position_key: u64,
}

/// Conditions at the start of the run of a stored program.
#[derive(Debug)]
pub(crate) struct RunStart {
    pub run_id: String,
    pub conditions: Arc<Conditions>,
}

impl Conditions {
    /// Collects the current conditions for a run from line 1.
    pub fn now(
        shared: &SharedState,
        view: &View,
        configured: &ConfiguredSystem,
        main: Arc<StoredProgram>,
    ) -> Self {
        Self::of_run(shared, view, configured, main, &shared.store.all(), None)
    }

    /// Collects the current conditions for a run with the programs in `all`, from a given line or from line 1.
    pub fn of_run(
        shared: &SharedState,
        view: &View,
        configured: &ConfiguredSystem,
        main: Arc<StoredProgram>,
        all: &BTreeMap<u16, Arc<StoredProgram>>,
        from: Option<LineStart>,
    ) -> Self {
        let cs = configured.settings.number;
        let state = state_of(shared, cs).unwrap_or_default();
        let skips = state.optional_skip.iter();
        let optional_skip = skips.filter_map(|n| 1_u32.checked_shl(u32::from(n.checked_sub(1)?)));
        // the text of an MDI run is not in the store
        let mains = main.check.programs.iter().copied().chain([main.number]);
        let called: BTreeSet<u16> = mains.flat_map(|main| called_by(all, main)).collect();
        let texts = all.iter().filter(|(number, program)| {
            called.contains(number) && program.dialect.name == configured.dialect.name
        });
        let mut texts: BTreeMap<_, _> = texts
            .map(|(number, program)| (*number, Arc::clone(program)))
            .collect();
        texts.insert(main.number, Arc::clone(&main));
        let tool = match shared
            .hub
            .read(&Topic::cs(cs, CsTopic::Tool))
            .map(|last| last.payload.clone())
        {
            Some(Payload::Tool(tool)) => Some(tool.id),
            _ => None,
        };
        let reads_variables = texts.values().any(|program| program.mentions_variables());
        let (tools, work_offsets, variables) = {
            let tables = shared.tables.read();
            let variables = copied(&shared.tables.variables(cs), reads_variables);
            (tables.tools().clone(), *tables.work_offsets(cs), variables)
        };
        let mut conditions = Self {
            programs: texts
                .iter()
                .map(|(number, program)| (*number, Arc::clone(&program.tree)))
                .collect(),
            main,
            texts,
            configured: configured.clone(),
            at: view.commanded(),
            tool,
            tools,
            work_offsets,
            optional_skip: optional_skip.fold(0, |bits, bit| bits | bit),
            optional_stop: state.optional_stop,
            dry_run: state.dry_run,
            single_block: state.single_block,
            captured: captured(shared, configured),
            variables,
            reads_variables,
            from,
            key: 0,
            position_key: 0,
        };
        conditions.key = conditions.digest();
        let mut hasher = DefaultHasher::new();
        let at = conditions.at.0.0.map(|at| ((at * 1e6).round() + 0.0).to_bits());
        at.hash(&mut hasher);
        conditions.position_key = hasher.finish();
        conditions
    }

    fn digest(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        for (number, program) in &self.texts {
            (number, program.checksum()).hash(&mut hasher);
        }
        let switches = (self.optional_stop, self.dry_run, self.single_block);
        (self.tool, self.optional_skip, switches).hash(&mut hasher);
        self.from.hash(&mut hasher);
        for (id, tool) in &self.tools {
            (id, tool.length.to_bits(), tool.radius.to_bits()).hash(&mut hasher);
        }
        for offset in &self.work_offsets.0 {
            offset.0.map(f64::to_bits).hash(&mut hasher);
        }
        if self.reads_variables {
            self.captured.map(f64::to_bits).hash(&mut hasher);
        }
        hasher.finish()
    }
}

/// Returns the state of a coordinate system.
pub(crate) fn state_of(shared: &SharedState, cs: CoordinateSystemNumber) -> Option<State> {
    match &shared.hub.read(&Topic::cs(cs, CsTopic::State))?.payload {
        Payload::State(state) => Some(state.clone()),
        _ => None,
    }
}

/// Returns the values of `_CNC_CapturedPosition<n>`.
fn captured(shared: &SharedState, configured: &ConfiguredSystem) -> [f64; AXES_MAX] {
    let cs = configured.settings.number;
    let mut values = [0.0; AXES_MAX];
    let last = shared.hub.read(&Topic::cs(cs, CsTopic::Captured));
    if let Some(Payload::Captured(CapturedPositions { positions, .. })) =
        last.map(|last| last.payload.clone())
    {
        for (value, position) in values.iter_mut().zip(positions) {
            *value = position;
        }
    }
    values
}

fn copied(variables: &Variables, is_read: bool) -> Variables {
    let copy = Variables {
        global: VariableArray::new(variables.global.len()),
        coordinate_system: VariableArray::new(COORDINATE_SYSTEM_VARIABLES),
    };
    let arrays = [
        (&variables.global, &copy.global),
        (&variables.coordinate_system, &copy.coordinate_system),
    ];
    for (from, to) in arrays.into_iter().filter(|_| is_read) {
        for i in 0..from.len() {
            to.set(i, from.get(i).unwrap_or_default());
        }
    }
    copy
}
