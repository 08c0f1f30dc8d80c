//! The signals by which an operating system ends a program.

use std::future::pending;
use std::io;

/// Waits for Ctrl-C, and on Unix also for SIGTERM, by which systemd, podman and `docker stop` end a process.
/// Use this future as the `stop` of [`SequenceProgram::run_until`](crate::SequenceProgram::run_until). From
/// the first poll on, these signals no longer end the process.
///
/// If the system refuses to report signals, a warning is logged and the future never completes; the signals
/// then end the process at once.
///
/// ```no_run
/// # use plc_api::{Plc, SequenceProgram};
/// # async fn main_of(program: SequenceProgram, plc: Plc) -> plc_api::Result<()> {
/// program.run_until(&plc, plc_api::stop_signal()).await
/// # }
/// ```
pub async fn stop_signal() {
    if let Err(error) = received().await {
        tracing::warn!(%error, "signals cannot be received: they end this program without finishing its work");
        pending::<()>().await;
    }
}

#[cfg(unix)]
async fn received() -> io::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};

    let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
    }
    Ok(())
}

#[cfg(not(unix))]
async fn received() -> io::Result<()> {
    tokio::signal::ctrl_c().await
}

#[cfg(all(test, unix))]
mod tests {
    use std::future::poll_fn;
    use std::pin::pin;
    use std::process::{Command, id};
    use std::task::Poll;
    use std::time::Duration;

    use super::*;

    #[tokio::test]
    async fn ctrl_c_and_sigterm_stop_a_program() {
        for signal in ["-INT", "-TERM"] {
            let mut stop = pin!(stop_signal());
            let first = poll_fn(|context| Poll::Ready(stop.as_mut().poll(context))).await;
            assert!(first.is_pending(), "{signal}");
            let sent = Command::new("kill")
                .args([signal, &id().to_string()])
                .status()
                .unwrap();
            assert!(sent.success());
            let stopped = tokio::time::timeout(Duration::from_secs(20), stop).await;
            assert!(stopped.is_ok(), "{signal}");
        }
    }
}
