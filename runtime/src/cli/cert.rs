//! `tandem cert`: creates a certificate for this machine, or for one of its clients.

use std::fs::OpenOptions;
use std::io::Write;
use std::net::IpAddr;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Error};
use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand};
use rcgen::{
    CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, KeyPair, KeyUsagePurpose,
};
use tandem_gateway::{Role, certificate_entry};

use super::token::{DAY_S, add_entry, is_known, record_in_journal};
use super::{CommandResult, EXIT_FOUND, EXIT_OK, complain, print_line};

#[derive(Args)]
pub struct CertArguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Creates a self-signed certificate of this computer, for all its names and addresses: cert.pem and key.pem
    New(New),
    /// Creates a certificate that identifies a client, and its entry in the token file
    Client(Client),
}

#[derive(Args)]
struct New {
    /// Folder to write cert.pem and key.pem into
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    out: PathBuf,
    /// Further name or address of the machine; can be repeated
    #[arg(long, value_name = "NAME")]
    host: Vec<String>,
    /// Configuration of the machine whose journal records the certificate; the machine must not run
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Validity in days
    #[arg(long, default_value_t = 825, value_parser = clap::value_parser!(u64).range(1..=3650))]
    days: u64,
}

#[derive(Args)]
struct Client {
    /// Name of the user
    name: String,
    /// Rights of the user
    #[arg(long, value_parser = PossibleValuesParser::new(Role::ALL.map(|(word, _)| word)))]
    role: String,
    /// Token file to append the entry to; created with mode 0600 if it does not exist
    #[arg(long, value_name = "FILE")]
    file: PathBuf,
    /// Folder to write NAME.cert.pem and NAME.key.pem into
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    out: PathBuf,
    /// Configuration of the machine whose journal records the certificate; the machine must not run
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Validity in days
    #[arg(long, default_value_t = 825, value_parser = clap::value_parser!(u64).range(1..=3650))]
    days: u64,
}

pub(super) fn run(arguments: &CertArguments) -> CommandResult {
    match &arguments.what {
        What::New(new) => of_machine(new),
        What::Client(client) => of_client(client),
    }
}

fn of_machine(new: &New) -> CommandResult {
    let name = host_name();
    let mut names = names_of_this_computer(&name)?;
    names.extend(new.host.iter().cloned());
    let made = make(&name, &names, new.days, ExtendedKeyUsagePurpose::ServerAuth)?;
    let (cert, key) = (new.out.join("cert.pem"), new.out.join("key.pem"));
    write_new(&key, &made.key, 0o600)?;
    write_new(&cert, &made.cert, 0o644)?;
    record_in_journal(
        new.config.as_deref(),
        &format!("tandem cert new: {}", cert.display()),
    );
    print_line(format!(
        "Certificate {} and key {} are written, for {}.\n\
         Write into the configuration:\n\n[tls]\ncert_file = \"{}\"\nkey_file = \"{}\"\n\n\
         Clients verify the machine with {}. The certificate is valid for {} days.",
        cert.display(),
        key.display(),
        names.join(", "),
        cert.display(),
        key.display(),
        cert.display(),
        new.days
    ));
    Ok(EXIT_OK)
}

fn of_client(client: &Client) -> CommandResult {
    let (name, file) = (&client.name, &client.file);
    let role = Role::of_name(&client.role).with_context(|| format!("there is no role {}", client.role))?;
    if is_known(file, name)? {
        complain(format!(
            "{} has an entry {name} already; remove it, or choose another name",
            file.display()
        ));
        return Ok(EXIT_FOUND);
    }
    let made = make(name, &[], client.days, ExtendedKeyUsagePurpose::ClientAuth)?;
    let until = SystemTime::now() + Duration::from_secs(client.days * DAY_S);
    let entry = certificate_entry(name, role, &made.der, Some(until)).map_err(Error::msg)?;
    let (cert, key) = (
        client.out.join(format!("{name}.cert.pem")),
        client.out.join(format!("{name}.key.pem")),
    );
    write_new(&key, &made.key, 0o600)?;
    write_new(&cert, &made.cert, 0o644)?;
    add_entry(file, &entry)?;
    let command = format!("tandem cert client {name} --role {}", client.role);
    record_in_journal(client.config.as_deref(), &command);
    print_line(format!(
        "Certificate {} and key {} are written, for {name}. The entry is in {}; a running runtime with this \
         token file reads it within 5 s.",
        cert.display(),
        key.display(),
        file.display()
    ));
    Ok(EXIT_OK)
}

struct IssuedCertificate {
    cert: String,
    key: String,
    der: Vec<u8>,
}

/// Creates a self-signed certificate, which cannot sign other certificates.
fn make(
    name: &str,
    names: &[String],
    days: u64,
    purpose: ExtendedKeyUsagePurpose,
) -> anyhow::Result<IssuedCertificate> {
    let key = KeyPair::generate()?;
    let mut params =
        CertificateParams::new(names.to_vec()).context("a name is not valid in a certificate")?;
    let mut subject = DistinguishedName::new();
    subject.push(DnType::CommonName, name);
    params.distinguished_name = subject;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![purpose];
    let now = time::OffsetDateTime::from(SystemTime::now());
    // The certificate is also valid for clients whose clock is up to one day slow.
    params.not_before = now - time::Duration::days(1);
    params.not_after = now + time::Duration::seconds(i64::try_from(days * DAY_S).unwrap_or(i64::MAX));
    let certificate = params.self_signed(&key)?;
    Ok(IssuedCertificate {
        cert: certificate.pem(),
        key: key.serialize_pem(),
        der: certificate.der().to_vec(),
    })
}

fn host_name() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    match name.trim() {
        "" => "localhost".to_owned(),
        name => name.to_owned(),
    }
}

/// Returns the names and addresses of this computer, including the loopback addresses.
fn names_of_this_computer(host: &str) -> anyhow::Result<Vec<String>> {
    let mut names = vec!["localhost".to_owned(), host.to_owned()];
    if !host.contains('.') {
        names.push(format!("{host}.local"));
    }
    let interfaces = if_addrs::get_if_addrs().context("cannot read the addresses of this computer")?;
    let is_of_one_link = |address: &IpAddr| matches!(address, IpAddr::V6(v6) if v6.is_unicast_link_local());
    let addresses = interfaces.iter().map(if_addrs::Interface::ip);
    names.extend(
        addresses
            .filter(|address| !is_of_one_link(address))
            .map(|address| address.to_string()),
    );
    Ok(names)
}

/// Writes a new file; returns an error if the file already exists.
fn write_new(path: &Path, text: &str, mode: u32) -> anyhow::Result<()> {
    let mut options = OpenOptions::new();
    let mut file = options
        .write(true)
        .create_new(true)
        .mode(mode)
        .open(path)
        .with_context(|| {
            format!(
                "cannot write {}; remove it, or name another folder with --out",
                path.display()
            )
        })?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    Ok(())
}
