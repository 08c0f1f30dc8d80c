//! Power of the drives of a channel's axes together, and of the drive of its spindle. The drives are enabled
//! before the first motion. If a drive fails or the bus is lost, the drives lose power until a reset or the
//! next motion.
//!
//! ```text
//!                  motion                    all drives follow
//!   Off, Tripped ----------> Enabling ------------------------------------> On
//!     Tripped      reset       |                                            |
//!        ^---------------------+--------------------------------------------+
//!                 not in time, a drive has a fault, the bus is lost
//! ```
//!
//! In `Off`, a drive fault or a lost bus also leads to `Tripped`, so that it is reported once before the first motion.

use crate::control::Fault;

/// Time limit for enabling the drives, including the clearing of their faults, s.
const ENABLING_S: f64 = 2.0;

/// State of the power of drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Power {
    /// Power was not requested since the start.
    Off,
    /// Power is off after a fault.
    Tripped {
        /// True if the drives must be enabled as soon as the channel is at rest.
        resets: bool,
    },
    /// Power is commanded, but the drives do not report it yet.
    Enabling {
        /// Number of cycles since the command.
        cycles: u64,
        /// True if the faults of the drives must be cleared.
        clears: bool,
    },
    On,
}

impl Power {
    /// Returns true if the drives must have power.
    pub(crate) fn is_commanded(self) -> bool {
        matches!(self, Power::Enabling { .. } | Power::On)
    }

    pub(crate) fn is_enabling(self) -> bool {
        matches!(self, Power::Enabling { .. })
    }

    /// Returns true if the drives must clear their faults.
    pub(crate) fn clears_faults(self) -> bool {
        matches!(self, Power::Enabling { clears: true, .. })
    }

    /// Requests power for a motion. `follows` is true if the drives already have power.
    pub(crate) fn ask(&mut self, follows: bool) {
        *self = if follows {
            Power::On
        } else {
            Power::Enabling {
                cycles: 0,
                clears: false,
            }
        };
    }

    /// Requests a reset, which takes effect when the channel is at rest.
    pub(crate) fn ask_for_reset(&mut self) {
        if let Power::Tripped { resets } = self {
            *resets = true;
        }
    }

    /// Executes a pending reset when the channel is at rest: clears faults and enables the drives. Returns
    /// true if a reset was pending.
    pub(crate) fn reset(&mut self) -> bool {
        let resets = *self == (Power::Tripped { resets: true });
        if resets {
            *self = Power::Enabling {
                cycles: 0,
                clears: true,
            };
        }
        resets
    }

    /// Executes one cycle. `trouble` is the fault that prevents the drives from following. Returns true if
    /// the drives have begun to follow, and an error if they must lose power.
    pub(crate) fn watch(&mut self, trouble: Option<Fault>, period_s: f64) -> Result<bool, Fault> {
        let (is_late, clears) = match self {
            Power::Tripped { .. } => return Ok(false),
            Power::Off => {
                let fault = trouble.filter(|fault| concerns_drives_without_power(*fault));
                return fault.map_or(Ok(false), |fault| {
                    *self = Power::Tripped { resets: false };
                    Err(fault)
                });
            }
            Power::On => (true, false),
            Power::Enabling { cycles, clears } => {
                *cycles += 1;
                let is_late = *cycles as f64 * period_s >= ENABLING_S;
                (is_late, *clears && !is_late)
            }
        };
        match trouble {
            None => Ok(std::mem::replace(self, Power::On).is_enabling()),
            Some(Fault::NotEnabled { .. }) if !is_late => Ok(false),
            Some(Fault::DriveFault { .. }) if clears => Ok(false),
            Some(fault) => {
                *self = Power::Tripped { resets: false };
                Err(fault)
            }
        }
    }
}

/// Returns true for a fault that is reported even if the drives were never enabled.
pub(crate) fn concerns_drives_without_power(fault: Fault) -> bool {
    matches!(fault, Fault::BusLost { .. } | Fault::DriveFault { .. })
}
