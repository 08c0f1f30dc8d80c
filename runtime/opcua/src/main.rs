//! `tandem-opcua`: an OPC UA server of one machine, in a separate process next to the runtime.

mod access;
mod cnc;
mod events;
mod feed;
mod instance;
mod machine_tool;
mod methods;
mod nodes;
mod nodesets;
mod options;
mod own;
mod program;
mod server;
mod values;
mod view;

use std::process::ExitCode;

use clap::Parser;

use options::Options;

#[tokio::main]
async fn main() -> ExitCode {
    let options = Options::parse();
    let filter = tracing_subscriber::EnvFilter::try_from_env("TANDEM_LOG")
        .unwrap_or_else(|_| "warn,opcua_server::address_space=error,tandem_opcua=info".into());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .init();
    match server::serve(options).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!("{error:#}");
            ExitCode::from(2)
        }
    }
}
