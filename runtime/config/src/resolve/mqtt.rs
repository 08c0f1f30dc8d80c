//! Checks `[mqtt]`.

use super::super::{Broker, MqttConfig};
use super::TableCheck;

impl MqttConfig {
    /// Checks the values, and rejects keys that have no effect with the configured broker. Files are checked
    /// later, when they are used.
    pub(super) fn check(&self, checked: &mut TableCheck<'_, '_>) {
        let users = [
            ("username", self.username.is_some()),
            ("password_file", self.password_file.is_some()),
        ];
        let files = [
            ("ca_file", self.ca_file.is_some()),
            ("client_cert_file", self.client_cert_file.is_some()),
            ("client_key_file", self.client_key_file.is_some()),
        ];
        match &self.broker {
            Broker::Embedded => {
                for (key, _) in users.into_iter().filter(|(_, is_there)| *is_there) {
                    let text = format!(
                        "{key} is for an external broker; the users of broker = \"embedded\" are in [http] \
                         token_file"
                    );
                    checked.problem(key, text);
                }
            }
            Broker::External(_) if self.listen.is_some() => {
                checked.problem(
                    "listen",
                    "listen is for broker = \"embedded\"; an external broker has its own address",
                );
            }
            Broker::External(_) => {}
        }
        if self.password_file.is_some() && self.username.is_none() {
            checked.problem("password_file", "password_file needs username");
        }
        let is_tls = matches!(&self.broker, Broker::External(nodes) if nodes.iter().any(|node| node.tls));
        if let Some((key, _)) = files.into_iter().find(|(_, is_there)| *is_there && !is_tls) {
            let text = "ca_file, client_cert_file and client_key_file are for broker = \"mqtts://host:port\"";
            checked.problem(key, text);
        }
        match (&self.client_cert_file, &self.client_key_file) {
            (Some(_), Some(_)) | (None, None) => {}
            (cert, _) => {
                let key = if cert.is_some() {
                    "client_cert_file"
                } else {
                    "client_key_file"
                };
                checked.problem(key, "client_cert_file and client_key_file need each other");
            }
        }
    }
}
