//! Clients that have asked to be watched: the machine holds when such a client is lost.
//!
//! A heartbeat names its client and the interval within which the next heartbeat must arrive. A heartbeat is neither a
//! lease (the right to start motion) nor the presence of a handler (the M codes that it serves); a client may have any
//! of them. Each loss causes one hold, so that an operator may resume without the client. The next heartbeat of the
//! client starts the watch again.

use std::collections::BTreeMap;

use plc_protocol::types::heartbeat::ClientHeartbeat;
use plc_protocol::types::request::{Refusal, RefusalCode};
use plc_protocol::types::state::Reason;
use tandem_model::alarm::CLIENT_LOST;

use crate::coordinate_system::CoordinateSystem;
use crate::coordinate_system::run::causes::Cause;

/// Maximum number of clients that one coordinate system watches. Heartbeats of further clients are refused.
pub(crate) const CLIENTS_MAX: usize = 64;

/// Interval in s at which the clients are inspected while a client is watched.
const LOOK_EVERY_S: f64 = 0.05;

/// Delay in s of an inspection above which the runtime itself was late and could not receive heartbeats: the process was
/// suspended, or the coordinate system did other work.
const LATE_S: f64 = 0.05;

/// Deadline for the next heartbeat of each watched client. Pure: the caller passes the time.
#[derive(Debug, Default)]
pub(crate) struct WatchedClients {
    clients: BTreeMap<String, WatchedClient>,
    /// Time of the last inspection.
    looked_s: f64,
}

#[derive(Debug)]
struct WatchedClient {
    beat: ClientHeartbeat,
    until_s: f64,
    /// True if the deadline was restarted since the last heartbeat because the runtime was late.
    is_excused: bool,
}

impl WatchedClients {
    /// Processes a heartbeat of a client: restarts its deadline, or ends its watch if `ttl_ms` is 0.
    ///
    /// # Errors
    /// Returns an error if the client is new and [`CLIENTS_MAX`] clients are already watched.
    fn receive_heartbeat(&mut self, id: String, beat: ClientHeartbeat, now_s: f64) -> Result<(), Refusal> {
        if beat.ttl_ms == 0 {
            self.clients.remove(&id);
            return Ok(());
        }
        if self.clients.len() >= CLIENTS_MAX && !self.clients.contains_key(&id) {
            let text = format!(
                "client {id} is not watched, because {CLIENTS_MAX} clients already are; release one by a \
                 heartbeat with ttl_ms 0"
            );
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        }
        let until_s = now_s + beat.ttl_ms as f64 / 1000.0;
        if self.clients.is_empty() {
            self.looked_s = now_s;
        }
        let watched = WatchedClient {
            beat,
            until_s,
            is_excused: false,
        };
        self.clients.insert(id, watched);
        Ok(())
    }

    /// Returns the time of the next inspection: the earliest deadline of all watched clients, or sooner. Returns `None`
    /// if no client is watched.
    pub fn until_s(&self) -> Option<f64> {
        let deadlines = self.clients.values().map(|watched| watched.until_s);
        let first = deadlines.min_by(f64::total_cmp)?;
        Some(first.min(self.looked_s + LOOK_EVERY_S))
    }

    /// Inspects the deadlines. Removes the clients whose deadline has passed, and returns them. If this inspection is
    /// late, first restarts the deadlines.
    fn inspect(&mut self, now_s: f64) -> Vec<(String, ClientHeartbeat)> {
        let since_s = now_s - std::mem::replace(&mut self.looked_s, now_s);
        if since_s > LOOK_EVERY_S + LATE_S {
            self.excuse(now_s);
        }
        self.lost(now_s)
    }

    fn lost(&mut self, now_s: f64) -> Vec<(String, ClientHeartbeat)> {
        let lost = self
            .clients
            .extract_if(.., |_, watched| watched.until_s <= now_s + 1e-9);
        lost.map(|(id, watched)| (id, watched.beat)).collect()
    }

    /// Restarts all deadlines, each once until the next heartbeat. Called when the runtime itself was late and could not
    /// receive heartbeats.
    pub fn excuse(&mut self, now_s: f64) {
        for watched in self.clients.values_mut().filter(|watched| !watched.is_excused) {
            watched.until_s = now_s + watched.beat.ttl_ms as f64 / 1000.0;
            watched.is_excused = true;
        }
    }
}

impl CoordinateSystem {
    pub(crate) fn receive_client_heartbeat(
        &mut self,
        id: String,
        beat: ClientHeartbeat,
    ) -> Result<(), Refusal> {
        self.inputs
            .clients
            .receive_heartbeat(id, beat, self.context.now_s())
    }

    /// Raises a warning and holds the run if the heartbeat of a client is overdue.
    pub(crate) fn look_at_clients(&mut self, now_s: f64) {
        if self.inputs.clients.clients.is_empty() {
            return;
        }
        for (id, beat) in self.inputs.clients.inspect(now_s) {
            let text = format!("client {id} sent no heartbeat for {} ms", beat.ttl_ms);
            self.context.warn_standing(&CLIENT_LOST, beat.cs, &text);
            self.hold_for(Cause::ClientLost, Reason::ClientLost);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use plc_api::{Execution, Plc};
    use plc_protocol::types::request::typed;
    use tandem_store::journal::Event;
    use tandem_testing::{Bench, kept_journal};

    use super::*;

    fn beat(ttl_ms: u64) -> ClientHeartbeat {
        ClientHeartbeat { ttl_ms, cs: None }
    }

    async fn send_heartbeat(plc: &Plc, id: &str, beat: ClientHeartbeat) -> Result<(), Refusal> {
        plc.port().ask(typed::Heartbeat(id.to_owned(), beat)).await
    }

    async fn start(plc: &Plc, cs: u8, program: u16) {
        plc.coordinate_system(cs).load(program).await.unwrap();
        plc.coordinate_system(cs).start().await.unwrap();
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn a_client_is_lost_at_its_time_and_not_before_and_one_that_goes_never_is() {
        let mut clients = WatchedClients::default();
        clients.receive_heartbeat("a".into(), beat(500), 1.0).unwrap();
        clients.receive_heartbeat("b".into(), beat(200), 1.0).unwrap();
        clients.receive_heartbeat("b".into(), beat(0), 1.1).unwrap();
        assert_eq!(clients.until_s(), Some(1.0 + LOOK_EVERY_S));
        assert_eq!(clients.lost(1.499), []);
        clients.excuse(1.499);
        assert_eq!(clients.lost(1.998), []);
        assert_eq!(clients.lost(1.999), [("a".to_owned(), beat(500))]);
        assert_eq!(clients.until_s(), None);
    }

    #[test]
    fn late_inspection_restarts_each_deadline_once_until_the_next_heartbeat() {
        let mut clients = WatchedClients::default();
        let lost = [("a".to_owned(), beat(500))];
        clients.receive_heartbeat("a".into(), beat(500), 1.0).unwrap();
        assert_eq!(clients.inspect(1.09), [], "on time");
        assert_eq!(clients.inspect(9.0), [], "the runtime was late");
        assert_eq!(clients.inspect(9.09), []);
        clients.receive_heartbeat("a".into(), beat(500), 9.1).unwrap();
        assert_eq!(clients.inspect(20.0), []);
        assert_eq!(clients.inspect(20.4), []);
        assert_eq!(clients.inspect(20.6), lost, "each heartbeat allows one delay");
    }

    #[test]
    fn suspension_in_a_dwell_or_a_wait_does_not_lose_a_client() {
        for text in ["G04 X60\nM30\n", "M77\nM30\n"] {
            let bench = Bench::on_machine({
                let mut machine = tandem_runtime::Config::demo().resolve().unwrap();
                machine.unhandled = tandem_runtime::UnhandledReaction::Wait;
                machine
            });
            let play = bench.subprogram(50, text).play(async move |scene, runtime| {
                let (plc, system) = (scene.plc(), scene.cs(1));
                start(plc, 1, 50).await;
                send_heartbeat(plc, "panel", beat(300)).await.unwrap();
                plc.sleep(ms(200)).await;
                let before = system.state().await.unwrap();
                runtime.simulation().unwrap().delay_servo(ms(1000));
                plc.sleep(ms(100)).await;
                for _ in 0..5 {
                    send_heartbeat(plc, "panel", beat(300)).await.unwrap();
                    plc.sleep(ms(200)).await;
                }
                let after = system.state().await.unwrap();
                assert_eq!(
                    (after.execution, after.reason),
                    (before.execution, before.reason),
                    "{text}"
                );
                plc.sleep(ms(400)).await;
                let held = system.state().await.unwrap();
                assert_eq!(held.reason, Some(Reason::ClientLost), "{text}");
            });
            play.unwrap();
        }
    }

    #[test]
    fn of_too_many_clients_one_that_is_known_is_heard_and_another_is_refused() {
        let mut clients = WatchedClients::default();
        for n in 0..CLIENTS_MAX {
            clients.receive_heartbeat(n.to_string(), beat(500), 0.0).unwrap();
        }
        assert!(clients.receive_heartbeat("0".into(), beat(500), 0.1).is_ok());
        let refusal = clients.receive_heartbeat("x".into(), beat(500), 0.1).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::Unavailable);
        clients.receive_heartbeat("0".into(), beat(0), 0.1).unwrap();
        assert!(clients.receive_heartbeat("x".into(), beat(500), 0.1).is_ok());
    }

    #[test]
    fn motion_holds_when_a_watched_client_expires_and_resume_runs_without_it() {
        let (journal, lines) = kept_journal();
        let bench = Bench::new()
            .journal(journal)
            .subprogram(50, "G01 X290 F6000\nM30\n");
        let play = bench.play(async |scene, _| {
            let (plc, system) = (scene.plc(), scene.cs(1));
            start(plc, 1, 50).await;
            for _ in 0..5 {
                send_heartbeat(plc, "panel", beat(200)).await.unwrap();
                plc.sleep(ms(190)).await;
            }
            assert_eq!(system.state().await.unwrap().execution, Execution::Active);
            let held = system.wait_until(Execution::FeedHold).await.unwrap();
            assert_eq!(held.reason, Some(Reason::ClientLost));
            let alarms = plc.alarms().await.unwrap();
            assert_eq!(
                (alarms.len(), alarms[0].number, alarms[0].cs),
                (1, CLIENT_LOST.number, None)
            );
            assert!(
                alarms[0]
                    .text
                    .contains("client panel sent no heartbeat for 200 ms"),
                "{alarms:?}"
            );
            plc.sleep(ms(1000)).await;
            send_heartbeat(plc, "panel", beat(200)).await.unwrap();
            let held = system.state().await.unwrap();
            assert_eq!(
                held.execution,
                Execution::FeedHold,
                "nothing resumes without a command"
            );
            send_heartbeat(plc, "panel", beat(0)).await.unwrap();
            system.resume().await.unwrap();
            system.wait_until(Execution::ProgramCompleted).await.unwrap();
        });
        play.unwrap();
        let lines = lines.lock().unwrap();
        let holds = lines.iter().filter_map(|line| match line.event {
            Event::Hold { reason, .. } => Some((line.cs, reason)),
            _ => None,
        });
        assert!(
            holds.eq([(1, Reason::ClientLost)]),
            "the other coordinate system runs nothing"
        );
    }

    #[test]
    fn client_loss_holds_only_its_coordinate_system_even_during_a_dwell() {
        let bench = Bench::new()
            .subprogram(50, "M00\nG04 X60\nM30\n")
            .subprogram(60, "G01 X50 F60\nM30\n");
        let play = bench.play(async |scene, _| {
            let plc = scene.plc();
            start(plc, 1, 50).await;
            start(plc, 2, 60).await;
            let of_first = ClientHeartbeat {
                ttl_ms: 300,
                cs: Some(1),
            };
            send_heartbeat(plc, "cell-1", of_first).await.unwrap();
            scene.cs(1).wait_until(Execution::ProgramStopped).await.unwrap();
            plc.sleep(ms(400)).await;
            let paused = scene.cs(1).state().await.unwrap();
            assert_eq!(paused.execution, Execution::ProgramStopped, "it already rests");
            scene.cs(1).resume().await.unwrap();
            send_heartbeat(plc, "cell-1", of_first).await.unwrap();
            let held = scene.cs(1).wait_until(Execution::FeedHold).await.unwrap();
            assert_eq!(held.reason, Some(Reason::ClientLost), "a dwell");
            let other = scene.cs(2).state().await.unwrap();
            assert_eq!(other.execution, Execution::Active);
            let refusal = send_heartbeat(
                plc,
                "x",
                ClientHeartbeat {
                    ttl_ms: 300,
                    cs: Some(9),
                },
            )
            .await;
            assert_eq!(refusal.unwrap_err().code, RefusalCode::NotFound);
        });
        play.unwrap();
    }

    #[test]
    fn a_program_of_plc_api_is_watched_until_it_ends_and_its_death_holds() {
        let bench = Bench::new().subprogram(50, "G01 X290 F6000\nX0\nX290\nM30\n");
        let play = bench.play(async |scene, _| {
            let (plc, system) = (scene.plc(), scene.cs(1));
            start(plc, 1, 50).await;
            let heartbeat = plc.heartbeat(ms(300)).await.unwrap();
            plc.sleep(ms(2000)).await;
            assert_eq!(system.state().await.unwrap().execution, Execution::Active);
            heartbeat.release().await.unwrap();
            plc.sleep(ms(1000)).await;
            assert_eq!(
                system.state().await.unwrap().execution,
                Execution::Active,
                "it behaved as required"
            );
            drop(system.heartbeat(ms(300)).await.unwrap());
            plc.sleep(ms(290)).await;
            assert_eq!(system.state().await.unwrap().execution, Execution::Active);
            let held = system.wait_until(Execution::FeedHold).await.unwrap();
            assert_eq!(held.reason, Some(Reason::ClientLost));
            assert!(plc.heartbeat(ms(50)).await.is_err() && plc.heartbeat(ms(60_001)).await.is_err());
        });
        play.unwrap();
    }

    #[test]
    fn a_program_hears_that_the_servo_is_alive_and_that_it_stands_still() {
        let play = Bench::new().play(async |scene, runtime| {
            let plc = scene.plc();
            let watching = plc.clone();
            let silent = tokio::spawn(async move { watching.until_silent(ms(500)).await });
            plc.sleep(ms(5000)).await;
            assert!(!silent.is_finished(), "at rest, too");
            runtime.simulation().unwrap().delay_servo(ms(1000));
            plc.sleep(ms(2000)).await;
            assert!(!silent.is_finished(), "it resumes before the next check");
            silent.abort();
        });
        play.unwrap();
    }
}
