//! Positions over time: the commanded positions that are sampled while a test runs.

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::Mutex;
use plc_protocol::types::CoordinateSystemNumber;
use tandem_model::Axis;
use tandem_runtime::Machine;
use tandem_runtime::simulation::OnCycle;

use super::TestError;

/// Maximum number of samples of one run, in all coordinate systems together. Reason: these samples need about
/// 200 MB; a larger number indicates a wrong interval.
const SAMPLES_MAX: usize = 1_000_000;

/// Position of a coordinate system at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Time of the sample, in seconds from the start of the programs.
    pub at_s: f64,
    /// Program and line of the block that moved last; `None` before the first block.
    pub block: Option<(u16, u32)>,
    /// Commanded machine positions by axis letter, mm or degrees.
    pub machine: BTreeMap<String, f64>,
}

/// Samples of each coordinate system, in ascending order of time.
pub(super) type Samples = BTreeMap<CoordinateSystemNumber, Vec<Sample>>;

#[derive(Default)]
struct SampleCollection {
    samples: Samples,
    count: usize,
    next_s: f64,
}

/// Takes samples of the positions in the servo cycles of a simulation.
#[derive(Clone, Default)]
pub(super) struct SampleTracer(Arc<Mutex<SampleCollection>>);

impl SampleTracer {
    /// Returns the callback that the simulation calls in each servo cycle.
    pub(super) fn on_cycle(&self, machine: &Machine, interval_s: f64) -> OnCycle {
        let taken = Arc::clone(&self.0);
        let systems: Vec<(CoordinateSystemNumber, Vec<Axis>)> = (machine.coordinate_systems.iter())
            .map(|system| (system.settings.number, system.settings.axes().iter().collect()))
            .collect();
        Box::new(move |servo| {
            let mut taken = taken.lock();
            let at_s = servo.time_s();
            // The tolerance is one nanosecond, because times are sums of periods.
            if at_s + 1e-9 < taken.next_s || taken.count > SAMPLES_MAX {
                return;
            }
            taken.next_s = at_s + interval_s;
            for (channel, (cs, axes)) in servo.channels().iter().zip(&systems) {
                let setpoint = channel.setpoint();
                let machine = axes
                    .iter()
                    .map(|axis| (axis.letter().to_string(), setpoint[*axis]));
                let sample = Sample {
                    at_s,
                    block: channel.executing().map(|origin| (origin.program, origin.line)),
                    machine: machine.collect(),
                };
                taken.samples.entry(*cs).or_default().push(sample);
                taken.count += 1;
            }
        })
    }

    /// Returns the samples since the start of the programs.
    ///
    /// # Errors
    /// Returns an error if the run has more than [`SAMPLES_MAX`] samples.
    pub(super) fn samples(&self, start_s: f64) -> Result<Samples, TestError> {
        let taken = std::mem::take(&mut *self.0.lock());
        if taken.count > SAMPLES_MAX {
            return Err(TestError::new(format!(
                "the trace has more than {SAMPLES_MAX} samples: give trace_every_s a longer interval"
            )));
        }
        let mut samples = taken.samples;
        for of_cs in samples.values_mut() {
            of_cs.retain(|sample| sample.at_s >= start_s);
            for sample in of_cs {
                sample.at_s -= start_s;
            }
        }
        Ok(samples)
    }
}
