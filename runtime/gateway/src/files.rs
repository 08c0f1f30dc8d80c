//! Limit of open files of this process: each connection is one.

use plc_protocol::server::ServerNotice;

use crate::broker;
use crate::connection_slots::SlotLimits;
use crate::machine::Machine;
use crate::server;

/// Number of files of the runtime besides connections of HTTP and the broker: store, journal, programs,
/// listeners, readers of MTConnect, the connection to an external broker.
const OWN_FILES: u64 = 128;

/// Minimum for these files, if the limit is low.
const OWN_FILES_MIN: u64 = 40;

/// Limits of connections, according to the file limit of this process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ConnectionLimits {
    pub(crate) http: SlotLimits,
    pub(crate) mqtt: SlotLimits,
    /// Warning for the operator, if there are fewer files than usual.
    pub(crate) warning: Option<String>,
}

impl ConnectionLimits {
    /// Raises the limit of files as far as this process may, and fits the connections into it. Warns if they are fewer than
    /// usual.
    pub(crate) fn raise(machine: &Machine) -> Self {
        let limits = Self::within(raise_limit());
        if let Some(text) = &limits.warning {
            tracing::warn!("{text}");
            machine.notice(ServerNotice::Warning(text.clone()));
        }
        limits
    }

    /// Returns the limits for this number of available files. `None` means that it is not limited.
    fn within(files: Option<u64>) -> Self {
        let usual = Self {
            http: server::SLOT_LIMITS,
            mqtt: broker::SLOT_LIMITS,
            warning: None,
        };
        let wanted = (usual.http.all + usual.mqtt.all) as u64;
        let Some(files) = files.filter(|files| *files < wanted + OWN_FILES) else {
            return usual;
        };
        let left = files.saturating_sub(OWN_FILES.min(files / 2).max(OWN_FILES_MIN));
        let (http, mqtt) = (usual.http.scaled(left, wanted), usual.mqtt.scaled(left, wanted));
        let text = format!(
            "this process may have only {files} files open, so {} HTTP and {} MQTT connections are accepted \
             instead of {} and \
             {}; raise the limit to {} (LimitNOFILE= of systemd, ulimit -Hn of a shell)",
            http.all,
            mqtt.all,
            usual.http.all,
            usual.mqtt.all,
            wanted + OWN_FILES
        );
        Self {
            http,
            mqtt,
            warning: Some(text),
        }
    }
}

/// Raises the soft limit of open files to the hard one. Returns the resulting limit; `None` if there is none.
#[cfg(unix)]
fn raise_limit() -> Option<u64> {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let raised = Rlimit {
        current: maximum,
        maximum,
    };
    match setrlimit(Resource::Nofile, raised) {
        Ok(()) => maximum,
        Err(_) => current,
    }
}

#[cfg(not(unix))]
fn raise_limit() -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_fit_into_the_files_of_the_process_with_a_warning() {
        let usual = ConnectionLimits::within(None);
        assert_eq!(usual.warning, None);
        assert_eq!(ConnectionLimits::within(Some(1024)), usual);
        for files in [64, 100, 256, 512, 800] {
            let fitted = ConnectionLimits::within(Some(files));
            let (http, mqtt) = (fitted.http, fitted.mqtt);
            let own = files - (http.all + mqtt.all) as u64;
            assert!(own >= OWN_FILES_MIN, "{files} files: {own} are left");
            for places in [http, mqtt] {
                assert!(places.all >= 8 && places.known < places.all && places.unauthenticated < places.all);
                assert!(places.of_one <= places.unauthenticated);
            }
            let text = fitted.warning.unwrap();
            assert!(
                text.contains(&format!("{files} files")) && text.contains("832"),
                "{text}"
            );
        }
        // below, the smallest usable number is kept
        assert_eq!(ConnectionLimits::within(Some(24)).http.all, 8);
    }

    #[cfg(unix)]
    #[test]
    fn the_soft_limit_of_files_is_raised_to_the_hard_one() {
        let raised = raise_limit();
        assert_eq!(
            raised,
            rustix::process::getrlimit(rustix::process::Resource::Nofile).maximum
        );
    }
}
