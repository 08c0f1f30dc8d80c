//! Each task and thread has a supervisor, or a listed consequence of its panic.

use std::path::Path;

use syn::visit::{self, Visit};
use syn::{Expr, ExprCall, ExprMethodCall, Ident};
use tandem_tidy::CRATES;
use tandem_tidy::product::{parse, sources};

/// Functions that start a task, a thread or a process.
const SPAWNS: [&str; 3] = ["spawn", "spawn_blocking", "spawn_scoped"];

/// Functions of the supervisor. A call that has one of them in its arguments is supervised.
const SUPERVISED: [&str; 5] = [
    "restarted",
    "essential",
    "contained",
    "catch_panic",
    "report_panic",
];

/// Crates of programs for tests only.
const FOR_TESTS: [&str; 1] = ["runtime/testing/src"];

/// Calls without a supervisor in their arguments: file, line, and the consequence of a panic.
const LISTED: [(&str, &str, &str); 34] = [
    (
        "plc-api/src/heartbeat.rs",
        "let beats = tokio::spawn(async move {",
        "the heartbeats end, and the machine holds with CLIENT_LOST",
    ),
    (
        "plc-api/src/lease.rs",
        "renewal: tokio::spawn(renew(self.clone(), take, ttl / RENEWALS, Arc::clone(&lost))),",
        "the lease ends after its time",
    ),
    (
        "plc-api/src/outputs/owner.rs",
        "presence: tokio::spawn(maintain_presence(presence, held, known)),",
        "the presence expires, as after a loss of the handler",
    ),
    (
        "plc-api/src/plc.rs",
        "runtime.spawn(work);",
        "an end that a dropped guard requests is not sent; the machine detects the loss",
    ),
    (
        "plc-api/protocol/src/supervisor.rs",
        "match tokio::task::spawn_blocking(work).await {",
        "the supervisor reports the panic that it awaits",
    ),
    (
        "plc-api/protocol/src/transport/client.rs",
        "tokio::spawn(Arc::clone(&client).keep_connected());",
        "the client stays offline; each of its requests fails",
    ),
    (
        "runtime/src/cli/fleet/machine.rs",
        "let serving = tokio::spawn(async move {",
        "a load test: its counts stay 0, and it fails",
    ),
    (
        "runtime/src/cli/fleet/machine.rs",
        "let reading = tokio::spawn(read(hmi.port().subscribe(Filter::All), Arc::clone(&counts), hmi));",
        "a load test: its counts stay 0, and it fails",
    ),
    (
        "runtime/src/cli/fleet/machine.rs",
        "let timing = tokio::spawn(time(handshake, Arc::clone(&counts)));",
        "a load test: its counts stay 0, and it fails",
    ),
    (
        "runtime/src/cli/lsp/timing.rs",
        "let Ok(mut child) = command.spawn() else {",
        "a process: its end is detected",
    ),
    (
        "runtime/src/cli/lsp/timing.rs",
        "std::thread::spawn(move || {",
        "the language server shows no time of a program",
    ),
    (
        "runtime/src/cli/lsp/transport.rs",
        "let writer = std::thread::spawn(move || {",
        "the channel closes, and the language server ends",
    ),
    (
        "runtime/src/cli/lsp/transport.rs",
        "std::thread::spawn(move || {",
        "the channel closes, and the language server ends",
    ),
    (
        "runtime/src/cli/memory.rs",
        "AbortOnDropHandle::new(tokio::spawn(async {",
        "only an interval and a call of the C library: free memory is not returned",
    ),
    (
        "runtime/src/cli/memory.rs",
        "let _ = tokio::task::spawn_blocking(trim).await;",
        "free memory is not returned in this interval",
    ),
    (
        "runtime/src/coordinator.rs",
        "let opened = tokio::task::spawn_blocking(open)",
        "the start of the runtime fails with the text of the panic",
    ),
    (
        "runtime/src/coordinator.rs",
        "let _ = tokio::task::spawn_blocking(move || drop(kept)).await;",
        "the end of the runtime continues; the next start inspects the data folder",
    ),
    (
        "runtime/src/coordinator.rs",
        "parts.tasks.spawn(previews.run_time_left_publisher());",
        "the publisher contains its supervisor, which restarts it",
    ),
    (
        "runtime/src/preview/mod.rs",
        "match std::thread::Builder::new().name(THREAD.into()).spawn(work) {",
        "`work` reports each panic and continues",
    ),
    (
        "runtime/src/servo_thread.rs",
        ".spawn(move || relay.run())?;",
        "`Relay::run`: a failure of the servo",
    ),
    (
        "runtime/src/servo_thread.rs",
        "let cycles = std::thread::Builder::new().name(\"servo\".into()).spawn(move || {",
        "`cycle_after`: a failure of the servo; an end of the thread stops the heartbeat",
    ),
    (
        "runtime/store/src/clock.rs",
        "let limited = std::thread::spawn(move || {",
        "a wait for the end of a simulation ends at once",
    ),
    (
        "runtime/store/src/program_store/program.rs",
        ".spawn_scoped(scope, sum);",
        "the caller computes the checksum",
    ),
    (
        "runtime/store/src/threads.rs",
        "let thread = builder.spawn(move || while work.wait_and_work() {})?;",
        "`SupervisedWork` restarts the work, then ends the process",
    ),
    (
        "runtime/gateway/src/access/login.rs",
        "let (is_right, weakness) = match tokio::task::spawn_blocking(check)",
        "the login continues the panic, which the supervisor of the connection reports",
    ),
    (
        "runtime/gateway/src/broker.rs",
        "_hall: AbortOnDropHandle::new(tokio::spawn(accepting)),",
        "`accepting` contains its supervisor: the process ends",
    ),
    (
        "runtime/gateway/src/mqtt/dispatch.rs",
        "tokio::spawn(asking); // with its supervisor",
        "`asking` contains its supervisor: only the request ends",
    ),
    (
        "runtime/gateway/src/mqtt/link.rs",
        "self.redelivering = is_again.then(|| tokio::spawn(self.parts.machine.republish()));",
        "`republish` contains its supervisor: only this redelivery ends",
    ),
    (
        "runtime/gateway/src/mqtt/urgent_lane.rs",
        "tokio::spawn(asking); // with its supervisor",
        "`asking` contains its supervisor: only the request ends",
    ),
    (
        "runtime/gateway/src/mqtt/wire.rs",
        "_poller: AbortOnDropHandle::new(tokio::spawn(event_loop.run(sender))),",
        "the link sees the end of the connection and connects again",
    ),
    (
        "runtime/opcua/src/methods.rs",
        "let carried_out = tokio::spawn(execute_method(plc, name, cs, method, inputs));",
        "the method fails with BadUnexpectedError",
    ),
    (
        "runtime/opcua/src/server.rs",
        "let mut tells = tokio::spawn(events::send_events(",
        "the server ends with an error",
    ),
    (
        "runtime/opcua/src/server.rs",
        "let mut follows = tokio::spawn(feed.follow());",
        "the server ends with an error",
    ),
    (
        "runtime/opcua/src/server.rs",
        "tokio::spawn(async move {",
        "the server ignores the signal to end, and is killed",
    ),
];

/// Lines of calls without a supervisor.
#[derive(Default)]
struct Unsupervised(Vec<usize>);

/// True if a name of [`SUPERVISED`] was found.
#[derive(Default)]
struct Supervision(bool);

impl<'ast> Visit<'ast> for Supervision {
    fn visit_ident(&mut self, name: &'ast Ident) {
        self.0 |= SUPERVISED.iter().any(|known| name == known);
    }
}

impl Unsupervised {
    fn look<'ast>(&mut self, line: usize, arguments: impl Iterator<Item = &'ast Expr>) {
        let mut found = Supervision::default();
        arguments.for_each(|one| found.visit_expr(one));
        if !found.0 {
            self.0.push(line);
        }
    }
}

impl<'ast> Visit<'ast> for Unsupervised {
    fn visit_expr_call(&mut self, call: &'ast ExprCall) {
        if let Expr::Path(function) = call.func.as_ref()
            && let Some(last) = function.path.segments.last()
            && SPAWNS.iter().any(|name| last.ident == name)
        {
            self.look(last.ident.span().start().line, call.args.iter());
        }
        visit::visit_expr_call(self, call);
    }

    fn visit_expr_method_call(&mut self, call: &'ast ExprMethodCall) {
        if SPAWNS.iter().any(|name| call.method == name) {
            self.look(call.method.span().start().line, call.args.iter());
        }
        visit::visit_expr_method_call(self, call);
    }
}

fn unsupervised(path: &Path, text: &str) -> Vec<usize> {
    let mut found = Unsupervised::default();
    found.visit_file(&parse(path, text));
    found.0
}

#[test]
fn p11_each_spawn_has_a_supervisor_or_a_listed_consequence() {
    let mut found = Vec::new();
    let mut listed: Vec<_> = LISTED.iter().map(|(file, line, _)| (*file, *line)).collect();
    for folder in CRATES.into_iter().filter(|folder| !FOR_TESTS.contains(folder)) {
        for source in sources(folder).into_values() {
            for line in unsupervised(&source.path, &source.text) {
                let text = source.text.lines().nth(line - 1).unwrap_or_default().trim();
                let file = source.path.display().to_string();
                let before = listed.len();
                listed.retain(|listed| *listed != (file.as_str(), text));
                if listed.len() == before {
                    found.push(format!("{file}:{line}: {text}"));
                }
            }
        }
    }
    assert!(
        found.is_empty(),
        "name a supervisor in the arguments, or list the call with the consequence of its panic:\n{}",
        found.join("\n")
    );
    assert!(listed.is_empty(), "remove from LISTED: {listed:?}");
}

#[test]
fn a_spawn_without_a_supervisor_is_found() {
    let text = "fn a() {\n    tokio::spawn(supervisor.essential(\"a\", work));\n    tokio::spawn(work);\n    \
                tasks\n        .spawn(work);\n    std::thread::spawn(move || catch(|| report_panic()));\n}\n";
    assert_eq!(unsupervised(Path::new("a.rs"), text), [3, 5]);
}
