//! The command line.

use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::{Context, bail, ensure};
use clap::{Parser, ValueEnum};
use plc_api::TlsFiles;

use crate::access::Machine;

/// An OPC UA server of one machine: OPC 40502 (CNC systems) and a part of OPC 40501 (machine tools), live, with the
/// commands and the M codes of the machine in a namespace of its own. It is a client of the runtime, and does not
/// authorize clients itself: the runtime checks the user name and the token with which the client has logged in.
#[derive(Debug, Parser)]
#[command(name = "tandem-opcua", version, term_width = 0)]
pub struct Options {
    /// Address of the machine: mqtt://[user:token@]host[:port]/[prefix/]machine or http://[[user:]token@]host[:port],
    /// with TLS mqtts:// or https://
    #[arg(long, value_name = "ADDRESS")]
    pub connect: String,
    /// User as which this server itself reads the machine
    #[arg(long, value_name = "NAME", requires = "token_file")]
    pub user: Option<String>,
    /// File with the token of the user that --user names
    #[arg(long, value_name = "FILE", requires = "user")]
    pub token_file: Option<PathBuf>,
    /// Certificate authorities for verifying the machine's certificate, PEM; default: those of the system
    #[arg(long, value_name = "FILE")]
    pub ca_file: Option<PathBuf>,
    /// Address for OPC UA clients
    #[arg(long, value_name = "IP:PORT", default_value = "127.0.0.1:4840")]
    pub listen: SocketAddr,
    /// Host name that clients receive; default: the IP of --listen
    #[arg(long, value_name = "NAME")]
    pub host: Option<String>,
    /// Rights of clients without a user; default: they may read if this server itself reads without a user
    #[arg(long, value_enum, value_name = "WHAT")]
    pub anonymous: Option<Anonymous>,
    /// Offers connections that are neither signed nor encrypted also to other computers: tokens cross the network in
    /// clear text
    #[arg(long)]
    pub insecure: bool,
    /// Folder of certificates: this server's own, created at its first start, and those of clients in trusted/ and
    /// rejected/
    #[arg(long, value_name = "FOLDER", default_value = "opcua-pki")]
    pub pki: PathBuf,
    /// Trusts every client's certificate: connections are encrypted, but the clients are not identified
    #[arg(long)]
    pub trust_any_client: bool,
}

/// Rights of clients without a user.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Anonymous {
    /// Reading only
    Read,
    /// No rights
    Refuse,
}

/// A user and its token.
pub type Credentials = (String, String);

impl Options {
    /// Returns the address of the machine, and the user as which this server reads it.
    ///
    /// # Errors
    /// Fails if the address is invalid, or if the token cannot be read.
    pub fn machine(&self) -> anyhow::Result<(Machine, Option<Credentials>)> {
        let Some((scheme, rest)) = self.connect.split_once("://") else {
            bail!("--connect: write mqtt://host:port/machine or http://host:port");
        };
        let (said, host) = rest
            .rsplit_once('@')
            .map_or((None, rest), |(said, host)| (Some(said), host));
        let tls = TlsFiles {
            ca_file: self.ca_file.clone(),
            ..TlsFiles::default()
        };
        let machine = Machine {
            address: format!("{scheme}://{host}"),
            tls,
        };
        let in_address = said.map(|said| match said.split_once(':') {
            Some((user, token)) => (user.to_owned(), token.to_owned()),
            None => (String::new(), said.to_owned()),
        });
        let in_file = match (&self.user, &self.token_file) {
            (Some(user), Some(file)) => {
                let token = std::fs::read_to_string(file)
                    .with_context(|| format!("cannot read {}", file.display()))?;
                Some((user.clone(), token.trim().to_owned()))
            }
            _ => None,
        };
        ensure!(
            in_address.is_none() || in_file.is_none(),
            "name the user in --connect or by --user and --token-file, not by both"
        );
        Ok((machine, in_file.or(in_address)))
    }

    /// Returns true if connections that are neither signed nor encrypted are offered.
    pub fn offers_none(&self) -> bool {
        self.insecure || self.listen.ip().is_loopback()
    }

    /// Returns true if clients without a user may read.
    pub fn is_anonymous_allowed(&self, reads_as: Option<&Credentials>) -> bool {
        match self.anonymous {
            Some(what) => what == Anonymous::Read,
            None => reads_as.is_none(),
        }
    }

    /// Returns the host name that clients receive.
    pub fn host(&self) -> String {
        self.host.clone().unwrap_or_else(|| self.listen.ip().to_string())
    }
}
