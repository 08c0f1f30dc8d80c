//! The Tandem runtime: the coordinator of CNC coordinate systems, and the only crate that depends on every stage.
//!
//! `runtime/ARCHITECTURE.md` in the repository follows one G01 and one M100 through the code.

mod alarms;
pub mod audit;
mod birth;
mod clock;
mod command_memory;
mod config;
mod coordinate_system;
mod coordinator;
pub mod data_folder;
mod data_watch;
pub mod declared;
mod disk;
pub mod explain;
mod heartbeat_times;
mod io;
pub mod journal;
mod order_key;
mod persistence;
mod planned;
mod port;
mod preview;
pub mod program_store;
mod published_data;
mod runs;
mod sequence;
mod servo_thread;
mod shared;
pub mod simulation;
pub mod stops;
mod stored_data;
mod tables;
#[cfg(feature = "testing")]
pub mod test;
mod threads;
pub mod trial;
#[cfg(test)]
mod world;

pub use clock::Clock;
pub use config::{
    Broker, Config, ConfigError, ConfigKey, ConfigWord, ConfiguredSystem, ExternalBroker, MCodeSettings,
    Machine, Stock, UnhandledReaction,
};
pub use coordinator::{Runtime, StartError};
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
