//! `[mqtt]`.

use super::super::{Broker, MqttConfig};

impl MqttConfig {
    /// Values, and keys that nothing reads beside this broker. What they name is looked at when it is used.
    pub(super) fn check(&self, problems: &mut Vec<String>) {
        let mut problem = |text: String| problems.push(format!("[mqtt] {text}"));
        let is_tls = matches!(&self.broker, Broker::External(broker) if broker.tls);
        match &self.broker {
            Broker::Embedded => {
                let unread = [
                    ("username", self.username.is_some()),
                    ("password_file", self.password_file.is_some()),
                ];
                for (key, _) in unread.iter().filter(|(_, is_there)| *is_there) {
                    problem(format!(
                        "{key} is for an external broker; the users of broker = \"embedded\" are those of [http] token_file"
                    ));
                }
            }
            Broker::External(_) if self.listen.is_some() => {
                problem("listen is for broker = \"embedded\"; an external one listens by itself".into());
            }
            Broker::External(_) => {}
        }
        if self.password_file.is_some() && self.username.is_none() {
            problem("password_file needs username".into());
        }
        let files = [&self.ca_file, &self.client_cert_file, &self.client_key_file];
        if !is_tls && files.iter().any(|file| file.is_some()) {
            problem(
                "ca_file, client_cert_file and client_key_file are for broker = \"mqtts://host:port\"".into(),
            );
        }
        if self.client_cert_file.is_some() != self.client_key_file.is_some() {
            problem("client_cert_file and client_key_file need each other".into());
        }
    }
}
