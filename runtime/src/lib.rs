//! The Tandem runtime: the coordinator of CNC coordinate systems, and the only crate that depends on every stage.
//!
//! `runtime/ARCHITECTURE.md` in the repository follows one G01 and one M100 through the code.

mod alarms;
pub mod audit;
mod birth;
mod command_memory;
mod coordinate_system;
mod coordinator;
mod data_watch;
mod heartbeat_times;
mod io;
mod planned;
mod port;
mod preview;
mod published_data;
mod sequence;
mod servo_thread;
mod shared;
pub mod simulation;
mod state_writer;
pub mod stops;
pub mod trial;

pub use coordinator::{Runtime, ServoCycles, StartError};
pub use tandem_config::{
    Broker, Config, ConfigError, ConfigKey, ConfigWord, ConfiguredSystem, ExternalBroker, MCodeSettings,
    Machine, ProgramSource, Stock, UnhandledReaction,
};
/// Interface to hardware: traits for a bus and a spindle of your own, and the factory that passes them to a runtime.
pub mod hardware {
    pub use tandem_model::settings::{CoordinateSystemSettings, MotorSettings};
    pub use tandem_servo::{
        BusCounts, Command, Cutoff, CycleResult, DriveBus, Feedback, Hardware, HardwareFactory, Orientation,
        Spindle, SpindleDirection, SpindleState, ThreadStep,
    };
}
pub use sequence::demo::{demo_sequence_program, open_demo};
pub use servo_thread::{DurationHistogram, JITTER_BUCKETS, ServoStatistics};
pub use tandem_config::{declared, explain};
pub use tandem_store::{Clock, data_folder, environment, journal, program_store};
