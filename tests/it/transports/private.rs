//! HTTP, WebSocket and the embedded broker with TLS: certificates from `tandem cert`, clients of plc-api.

use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;

use plc_api::{Alarm, AuxOutput, MqttOptions, Plc, SequenceProgram, TlsFiles};
use plc_protocol::types::request::typed::{Programs, Tool};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::support::binary::tandem;
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::{until, within};

fn run(machine: &Machine, arguments: &[&str]) -> String {
    let output = Command::new(tandem())
        .args(arguments)
        .current_dir(machine.folder())
        .output()
        .expect("tandem starts");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        output.status.success(),
        "{said}{}",
        String::from_utf8_lossy(&output.stderr)
    );
    said
}

/// A machine with its own certificate, which requires users.
fn machine() -> (Machine, String) {
    let http = FREE_PORTS.replace("[http]\n", "[http]\ntoken_file = \"tokens.toml\"\n");
    let machine = Machine::new(&format!(
        "programs = {{ 50 = \"tool.nc\" }}\n[m_code.100]\nunhandled = \"wait\"\n{http}\n\
         [tls]\ncert_file = \"cert.pem\"\nkey_file = \"key.pem\"\n"
    ));
    machine.write("tool.nc", "M100 VA7\nM30\n");
    run(&machine, &["cert", "new"]);
    let said = run(
        &machine,
        &[
            "token",
            "hmi-1",
            "--role",
            "operate",
            "--file",
            "tokens.toml",
            "--days",
            "30",
        ],
    );
    let token = said
        .lines()
        .find_map(|line| line.strip_prefix("token: "))
        .expect("a token");
    (machine, token.to_owned())
}

fn options(machine: &Machine, user: Option<(&str, &str)>) -> MqttOptions {
    MqttOptions {
        username: user.map(|(name, _)| name.to_owned()),
        password: user.map(|(_, token)| token.to_owned()),
        tls: TlsFiles {
            ca_file: Some(machine.path("cert.pem")),
            ..TlsFiles::default()
        },
        ..MqttOptions::default()
    }
}

fn private(url: &str) -> String {
    url.replace("http://", "https://").replace("mqtt://", "mqtts://")
}

#[tokio::test]
async fn with_a_certificate_http_websocket_and_the_broker_speak_tls_only() {
    let (machine, token) = machine();
    let key = std::fs::metadata(machine.path("key.pem")).unwrap();
    assert_eq!(key.permissions().mode() & 0o777, 0o600);
    let served = Served::start(&machine);
    for url in [served.http_url(), served.mqtt_url()] {
        let user = Some(("hmi-1", token.as_str()));
        let plc = Plc::connect_with(&private(&url), options(&machine, user)).await;
        let plc = within("connect", async { plc }).await.expect(&url);
        assert_eq!(plc.port().ask(Tool(1, 4)).await, Ok(()), "{url}");
    }
    let mut plain = TcpStream::connect(&served.http).await.unwrap();
    let get = format!("GET /api/v1/health HTTP/1.1\r\nHost: {}\r\n\r\n", served.http);
    plain.write_all(get.as_bytes()).await.unwrap();
    let mut answer = String::new();
    within("an answer", plain.read_to_string(&mut answer))
        .await
        .unwrap();
    assert!(
        answer.starts_with("HTTP/1.1 400") && answer.contains("https://"),
        "{answer}"
    );
    // a client that does not trust the certificate cannot reach the machine, and none is accepted without TLS; each
    // tries until its time is over, all at once
    let stranger = || MqttOptions {
        tls: TlsFiles::default(),
        ..options(&machine, Some(("hmi-1", token.as_str())))
    };
    let (http, mqtt) = (private(&served.http_url()), private(&served.mqtt_url()));
    let unprotected = served.mqtt_url();
    let (http, mqtt, unprotected) = tokio::join!(
        Plc::connect_with(&http, stranger()),
        Plc::connect_with(&mqtt, stranger()),
        Plc::connect_with(&unprotected, stranger()),
    );
    for refused in [http, mqtt] {
        let refused = refused.expect_err("not trusted").to_string();
        assert!(
            refused.contains("certificate") || refused.contains("authorities"),
            "{refused}"
        );
    }
    unprotected.expect_err("without TLS nobody is let in");
}

#[tokio::test]
async fn known_certificate_needs_no_token_and_an_unlisted_one_is_refused() {
    let (machine, _) = machine();
    run(
        &machine,
        &[
            "cert",
            "client",
            "magazine",
            "--role",
            "handler",
            "--file",
            "tokens.toml",
        ],
    );
    let served = Served::start(&machine);
    let with = |name: &str| MqttOptions {
        tls: TlsFiles {
            client_cert_file: Some(machine.path(&format!("{name}.cert.pem"))),
            client_key_file: Some(machine.path(&format!("{name}.key.pem"))),
            ..options(&machine, None).tls
        },
        ..MqttOptions::default()
    };
    let (http, mqtt) = (private(&served.http_url()), private(&served.mqtt_url()));
    let rest = Plc::connect_with(&http, with("magazine"));
    let rest = within("connect", rest).await.expect("over REST");
    let refused = rest
        .port()
        .ask(Tool(1, 4))
        .await
        .expect_err("it serves nothing yet");
    assert!(refused.text.contains("handler magazine serves none"), "{refused}");
    let mqtt = Plc::connect_with(&mqtt, with("magazine"));
    let mqtt = within("connect", mqtt).await.expect("over MQTT");
    let program = SequenceProgram::new()
        .handler_id("magazine")
        .on(100, |_: AuxOutput| async { Ok::<(), Alarm>(()) });
    let serving = mqtt.clone();
    let _handlers = tokio::spawn(async move { program.run(&serving).await });
    until(
        "the handler of the certificate is there, and sets a tool",
        async || rest.port().ask(Tool(1, 4)).await.ok(),
    )
    .await;
    run(
        &machine,
        &[
            "cert",
            "client",
            "stranger",
            "--role",
            "admin",
            "--file",
            "other.toml",
        ],
    );
    let refused = Plc::connect_with(&http, with("stranger"))
        .await
        .expect_err("nobody")
        .to_string();
    assert!(refused.contains("401"), "{refused}");
    assert_eq!(rest.port().ask(Programs).await.expect("read").len(), 1);
}
