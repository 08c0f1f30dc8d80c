//! The server: endpoints, limits, start and stop.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, anyhow, ensure};
use opcua::crypto::SecurityPolicy;
use opcua::server::authenticator::AuthManager;
use opcua::server::node_manager::memory::InMemoryNodeManagerBuilder;
use opcua::server::{
    ANONYMOUS_USER_TOKEN_ID, Limits, Server, ServerBuilder, ServerEndpoint, ServerHandle, SubscriptionLimits,
};
use opcua::types::MessageSecurityMode;
use plc_api::Plc;
use plc_protocol::hub::Filter;
use tokio::net::TcpListener;
use tokio::sync::mpsc;

use crate::access::{Access, LOGIN_TIMEOUT, Machine};
use crate::events;
use crate::feed::MachineFeed;
use crate::nodes::{NodesBuilder, manager};
use crate::nodesets;
use crate::options::{Credentials, Options};
use crate::program::ActiveProgram;
use crate::view::View;

/// Largest number of sessions. Reason: the clients of a plant and a margin; each costs about ten kilobytes.
const SESSIONS_MAX: usize = 200;

/// Largest number of subscriptions of one session.
const SUBSCRIPTIONS_MAX: usize = 20;

/// Largest number of variables in one subscription. Reason: all variables of a machine with eight coordinate systems.
const MONITORED_ITEMS_MAX: usize = 5000;

/// Largest number of values of one variable that wait for a client; the oldest are dropped.
const QUEUE_MAX: usize = 100;

/// Largest size of one message, bytes.
const MESSAGE_BYTES_MAX: usize = 4 * 1024 * 1024;

/// Shortest sampling interval: the machine sends positions ten times a second.
const INTERVAL_MIN_MS: f64 = 100.0;

/// Pause before the next attempt to connect to the machine.
const AGAIN_AFTER: Duration = Duration::from_secs(2);

/// Serves until the process receives a signal to end.
///
/// # Errors
/// Fails if an option cannot be used, or if the address is in use.
pub async fn serve(options: Options) -> anyhow::Result<()> {
    let (machine, user) = options.machine()?;
    let listener = TcpListener::bind(options.listen)
        .await
        .with_context(|| format!("cannot listen on {}", options.listen))?;
    let plc = tokio::select! {
        plc = connect(&machine, user.as_ref()) => plc?,
        () = end_signal() => return Ok(()),
    };
    if !options.listen.ip().is_loopback() {
        refuse_without_users(&machine).await?;
    }
    let mut view = View::default();
    let mut messages = plc.port().subscribe(Filter::All);
    while let Some(message) = messages.try_next() {
        view.apply_message(&message);
    }
    drop(messages);
    let port = listener.local_addr()?.port();
    let is_anonymous_allowed = options.is_anonymous_allowed(user.as_ref());
    let access = Arc::new(Access::new(machine, is_anonymous_allowed));
    let name = view.birth.machine.clone();
    let (server, handle) = build(&options, port, &name, view.clone(), access)?;
    let manager = manager(&handle).context("the node manager is missing")?;
    let (happened, waiting) = mpsc::channel(events::WAITING_MAX);
    let mut tells = tokio::spawn(events::send_events(
        waiting,
        plc.clone(),
        Arc::clone(handle.subscriptions()),
        manager.inner().event_ids(),
    ));
    let mut feed = MachineFeed {
        plc,
        manager,
        subscriptions: Arc::clone(handle.subscriptions()),
        view,
        program: ActiveProgram::default(),
        written: BTreeMap::new(),
        happened,
        alarms: BTreeMap::new(),
        messages: BTreeMap::new(),
    };
    tokio::select! {
        () = feed.publish_initial_state() => {}
        () = end_signal() => return Ok(()),
    }
    print_line(&format!("OPC UA of {name}: opc.tcp://{}:{port}/", options.host()));
    let mut follows = tokio::spawn(feed.follow());
    let end = handle.token().clone();
    tokio::spawn(async move {
        end_signal().await;
        end.cancel();
    });
    // without one of these tasks, clients would see stale values
    let served = tokio::select! {
        served = server.run_with(listener) => served.map_err(|error| anyhow!(error)),
        ended = &mut follows => Err(anyhow!("the values of the machine are no longer read: {ended:?}")),
        ended = &mut tells => Err(anyhow!("the events of the machine are no longer sent: {ended:?}")),
    };
    follows.abort();
    tells.abort();
    served
}

/// Connects to the machine as soon as it is online.
async fn connect(machine: &Machine, user: Option<&Credentials>) -> anyhow::Result<Plc> {
    loop {
        match machine
            .connect(user.map(|(name, token)| (name.as_str(), token.as_str())))
            .await
        {
            Ok(plc) => return Ok(plc),
            Err(error @ plc_api::Error::Address { .. }) => return Err(error.into()),
            Err(error) => {
                tracing::warn!("{error}; trying again");
                tokio::time::sleep(AGAIN_AFTER).await;
            }
        }
    }
}

/// Rejects a machine without users, because it accepts commands from every client and must not be reached from the
/// network.
async fn refuse_without_users(machine: &Machine) -> anyhow::Result<()> {
    let stranger = machine.connect(Some(("stranger", "no token of anybody")));
    let is_taken = matches!(tokio::time::timeout(LOGIN_TIMEOUT, stranger).await, Ok(Ok(_)));
    ensure!(
        !is_taken,
        "the machine has no users, so that every client of this server could command it: give the runtime a \
         token_file, or listen on the loopback interface"
    );
    Ok(())
}

fn build(
    options: &Options,
    port: u16,
    machine: &str,
    view: View,
    access: Arc<Access>,
) -> anyhow::Result<(Server, ServerHandle)> {
    let host = options.host();
    let sets = nodesets::read()?;
    let mut builder = ServerBuilder::new()
        .application_name(format!("Tandem {machine}"))
        .application_uri(format!("urn:{host}:tandem:{machine}"))
        .product_uri("https://github.com/tandem-nc/tandem")
        .host(host)
        .port(port)
        .discovery_urls(vec!["/".to_owned()])
        .pki_dir(&options.pki)
        .create_sample_keypair(true)
        .certificate_path("own/cert.der")
        .private_key_path("private/private.pem")
        .trust_client_certs(options.trust_any_client)
        .with_authenticator(Arc::clone(&access) as Arc<dyn AuthManager>)
        .limits(limits())
        .diagnostics_enabled(false)
        .with_node_manager(InMemoryNodeManagerBuilder::new(NodesBuilder {
            sets,
            view,
            access,
        }));
    let users = [ANONYMOUS_USER_TOKEN_ID.to_owned()];
    if options.offers_none() {
        builder = builder.add_endpoint("none", ServerEndpoint::new_none("/", &users));
    }
    for (name, mode) in [
        ("sign", MessageSecurityMode::Sign),
        ("sign_and_encrypt", MessageSecurityMode::SignAndEncrypt),
    ] {
        let endpoint = ServerEndpoint::new("/", SecurityPolicy::Basic256Sha256, mode, &users);
        builder = builder.add_endpoint(name, endpoint);
    }
    builder.build().map_err(|error| anyhow!(error))
}

fn limits() -> Limits {
    Limits {
        max_sessions: SESSIONS_MAX,
        max_message_size: MESSAGE_BYTES_MAX,
        max_browse_continuation_points: 20,
        max_history_continuation_points: 1,
        max_query_continuation_points: 1,
        subscriptions: SubscriptionLimits {
            max_subscriptions_per_session: SUBSCRIPTIONS_MAX,
            max_monitored_items_per_sub: MONITORED_ITEMS_MAX,
            max_monitored_item_queue_size: QUEUE_MAX,
            min_sampling_interval_ms: INTERVAL_MIN_MS,
            min_publishing_interval_ms: INTERVAL_MIN_MS,
            ..SubscriptionLimits::default()
        },
        ..Limits::default()
    }
}

/// Prints a line on standard output. A closed reader does not end the server.
fn print_line(line: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{line}");
}

/// Waits until the process is interrupted or terminated.
async fn end_signal() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut terminated) = signal(SignalKind::terminate()) {
            tokio::select! {
                _ = tokio::signal::ctrl_c() => {}
                _ = terminated.recv() => {}
            }
            return;
        }
    }
    let _ = tokio::signal::ctrl_c().await;
}
