//! A Mosquitto as in a plant: TLS with a private authority, client certificates, users with passwords, and
//! the access rules that `tandem mqtt-acl` prints.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use plc_api::{Alarm, AuxOutput, Execution, MqttOptions, Plc, SequenceProgram, TlsFiles};
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};
use tempfile::TempDir;

use super::machine;
use crate::support::binary::tandem;
use crate::support::broker::{Mosquitto, add_password};
use crate::support::machine::Machine;
use crate::support::served::Served;
use crate::support::wait::within;

/// Creates files in a folder: `ca.pem`, and certificates and keys of the server and a client, signed by it.
fn make_certificates(folder: &Path) {
    let mut params = CertificateParams::new(Vec::new()).expect("parameters");
    params.distinguished_name.push(DnType::CommonName, "the plant");
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let key = KeyPair::generate().expect("a key");
    let authority = params.self_signed(&key).expect("a certificate");
    std::fs::write(folder.join("ca.pem"), authority.pem()).expect("written");
    let issuer = Issuer::new(params, key);
    for name in ["server", "client"] {
        let mut params = CertificateParams::new(vec!["127.0.0.1".to_owned()]).expect("parameters");
        params.distinguished_name.push(DnType::CommonName, name);
        let key = KeyPair::generate().expect("a key");
        let certificate = params.signed_by(&key, &issuer).expect("a certificate");
        std::fs::write(folder.join(format!("{name}.pem")), certificate.pem()).expect("written");
        std::fs::write(folder.join(format!("{name}.key")), key.serialize_pem()).expect("written");
    }
}

/// Returns the output of `tandem`.
fn printed(folder: &Path, arguments: &[&str]) -> String {
    let output = Command::new(tandem())
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("tandem starts");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        output.status.success(),
        "{text}{}",
        String::from_utf8_lossy(&output.stderr)
    );
    text
}

struct Plant {
    broker: Mosquitto,
    machine: Machine,
    tokens: BTreeMap<&'static str, String>,
}

const BROKER: &str = "cafile ca.pem\ncertfile server.pem\nkeyfile server.key\nrequire_certificate true\nallow_anonymous false\npassword_file passwords\nacl_file acl\n";

impl Plant {
    fn new() -> Self {
        let folder = TempDir::new().expect("a folder");
        make_certificates(folder.path());
        // the machine's configuration needs the broker's port, and the broker the machine's rules
        let broker_folder = folder.path().to_owned();
        let passwords = folder.path().join("passwords");
        add_password(&passwords, "mill-1", "runtime-secret");
        std::fs::write(folder.path().join("acl"), "").expect("written");
        let mut broker = Mosquitto::with(folder, BROKER);
        let file = |name: &str| broker_folder.join(name).display().to_string();
        std::fs::write(broker_folder.join("password"), "runtime-secret\n").expect("written");
        let machine = machine(&format!(
            "[http]\nlisten = \"127.0.0.1:0\"\ntoken_file = \"tokens.toml\"\n[mqtt]\nbroker = \"mqtts://{}\"\nusername = \"mill-1\"\npassword_file = \"{}\"\nca_file = \"{}\"\nclient_cert_file = \"{}\"\nclient_key_file = \"{}\"\n",
            broker.address(),
            file("password"),
            file("ca.pem"),
            file("client.pem"),
            file("client.key")
        ));
        let mut tokens = BTreeMap::new();
        for (name, role) in [("magazine", "admin"), ("watcher", "view")] {
            let arguments = ["token", name, "--role", role, "--file", "tokens.toml"];
            let text = printed(machine.folder(), &arguments);
            let token = text.lines().find_map(|line| line.strip_prefix("token: "));
            let token = token.expect("a token").to_owned();
            add_password(&passwords, name, &token);
            tokens.insert(name, token);
        }
        let config = machine.config();
        let rules = printed(
            machine.folder(),
            &["mqtt-acl", "--config", config.to_str().expect("UTF-8")],
        );
        std::fs::write(broker_folder.join("acl"), rules).expect("written");
        broker.kill();
        broker.start_again();
        Self {
            broker,
            machine,
            tokens,
        }
    }

    fn url(&self) -> String {
        format!("mqtts://{}/test-1", self.broker.address())
    }

    fn files(&self) -> TlsFiles {
        let file = |name: &str| -> Option<PathBuf> { Some(self.broker.folder().join(name)) };
        TlsFiles {
            ca_file: file("ca.pem"),
            client_cert_file: file("client.pem"),
            client_key_file: file("client.key"),
        }
    }

    fn options(&self, user: &str, tls: TlsFiles) -> MqttOptions {
        MqttOptions {
            username: Some(user.to_owned()),
            password: self.tokens.get(user).cloned(),
            tls,
            ..MqttOptions::default()
        }
    }

    async fn connect(&self, options: MqttOptions) -> plc_api::Result<Plc> {
        within("connect", Plc::connect_with(&self.url(), options)).await
    }
}

#[tokio::test]
async fn program_runs_over_mosquitto_with_tls_certificates_and_passwords() {
    let plant = Plant::new();
    let served = Served::start(&plant.machine);
    let options = plant.options("magazine", plant.files());
    let plc = plant.connect(options).await.expect("a machine there");
    let serving = plc.clone();
    let change_tool = |output: AuxOutput, plc: Plc| async move {
        let system = plc.coordinate_system(output.coordinate_system());
        system.select_tool(7).await?;
        Ok::<(), Alarm>(())
    };
    let handlers =
        tokio::spawn(async move { SequenceProgram::new().on(100, change_tool).run(&serving).await });
    let system = plc.coordinate_system(1);
    within("load", system.load(50)).await.expect("load");
    within("start", system.start()).await.expect("start");
    let done = system.wait_for(|state| state.execution == Execution::ProgramCompleted);
    within("its end", done).await.expect("completed");
    assert_eq!(system.tool().await.expect("a tool").id, 7);

    // the broker's rules drop messages of a read-only user
    let watcher = plant
        .connect(plant.options("watcher", plant.files()))
        .await
        .expect("let in");
    let watched = watcher.coordinate_system(1);
    let asked = watched.select_tool(3);
    // Mosquitto acknowledges messages that its rules drop
    within("an acknowledgement", asked).await.expect("taken");
    within("hold", system.hold())
        .await
        .expect("what is said after it is done");
    assert_eq!(system.tool().await.expect("a tool").id, 7);
    handlers.abort();
    drop(served);
}

#[tokio::test]
async fn untrusted_broker_and_unknown_client_do_not_connect() {
    let plant = Plant::new();
    let other = TempDir::new().expect("a folder");
    make_certificates(other.path());
    let mut wrong_password = plant.options("watcher", plant.files());
    wrong_password.password = Some("guessed".to_owned());
    let foreign_authority = TlsFiles {
        ca_file: Some(other.path().join("ca.pem")),
        ..plant.files()
    };
    let no_certificate = TlsFiles {
        ca_file: plant.files().ca_file,
        ..TlsFiles::default()
    };
    let options = [
        wrong_password,
        plant.options("watcher", foreign_authority),
        plant.options("watcher", no_certificate),
    ];
    let tries = options.map(|options| plant.connect(options));
    for result in futures_util::future::join_all(tries).await {
        let error = result.expect_err("refused").to_string();
        assert!(
            !error.contains("guessed") && !error.contains("no runtime is online"),
            "{error}"
        );
    }
}
