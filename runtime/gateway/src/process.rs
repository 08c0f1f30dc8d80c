//! The resources that this process uses, as Linux reports them.

use std::fs::read_to_string;

/// Clock ticks of a second in `/proc/self/stat`, the same on every Linux.
const TICKS_PER_SECOND: f64 = 100.0;

/// Resources that a process has used so far.
#[derive(Debug, Clone, Copy, Default)]
pub struct Usage {
    /// Time of all cores, s; `None` if the system does not provide it.
    pub cpu_s: Option<f64>,
    /// Resident memory, bytes; `None` if the system does not provide it.
    pub resident_bytes: Option<u64>,
}

impl Usage {
    /// Returns the current usage of this process.
    pub fn now() -> Self {
        let read = |name| read_to_string(format!("/proc/self/{name}")).unwrap_or_default();
        Self {
            cpu_s: cpu_s(&read("stat")),
            resident_bytes: resident_bytes(&read("status")),
        }
    }
}

/// Returns user and system time of `/proc/self/stat`: fields 14 and 15, counted after the name in parentheses.
fn cpu_s(stat: &str) -> Option<f64> {
    let (_, behind) = stat.rsplit_once(')')?;
    let mut fields = behind.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<u64>().ok();
    Some((ticks()? + ticks()?) as f64 / TICKS_PER_SECOND)
}

/// Returns the resident memory in bytes, from `VmRSS` of `/proc/self/status`.
fn resident_bytes(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes = line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?;
    Some(kilobytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_linux_says_of_a_process_is_read_by_place_and_name() {
        let stat = "17 (a) name) S 1 17 17 0 -1 4194560 100 0 0 0 250 50 0 0 20 0 4 0 100 1000 200";
        assert_eq!(cpu_s(stat), Some(3.0));
        assert_eq!(cpu_s(""), None);
        let status = "Name:\ttandem\nVmPeak:\t  9000 kB\nVmRSS:\t  2048 kB\n";
        assert_eq!(resident_bytes(status), Some(2 * 1024 * 1024));
        assert_eq!(resident_bytes("VmRSS:\tmuch"), None);
    }
}
