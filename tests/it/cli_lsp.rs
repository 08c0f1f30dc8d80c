//! `tandem lsp` as a process, over standard input and output.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use serde_json::{Value, json};

use crate::support::binary::tandem;
use crate::support::machine::Machine;

/// An editor that speaks to the language server.
struct Editor {
    child: Child,
    stdin: ChildStdin,
    stdout: BufReader<ChildStdout>,
}

impl Drop for Editor {
    fn drop(&mut self) {
        // the process may already have ended
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Editor {
    fn new(machine: &Machine) -> Self {
        let mut child = Command::new(tandem())
            .args(["lsp", "--stdio"])
            .current_dir(machine.folder())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("tandem starts");
        let (stdin, stdout) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        let mut editor = Self {
            child,
            stdin,
            stdout: BufReader::new(stdout),
        };
        let capabilities = json!({"workspace": {"codeLens": {"refreshSupport": true}}});
        editor.send(json!({"id": 1, "method": "initialize", "params": {"capabilities": capabilities}}));
        let server = editor.wait_for(|message| message["id"] == 1);
        assert_eq!(server["result"]["serverInfo"]["name"], "tandem");
        editor.send(json!({"method": "initialized", "params": {}}));
        editor
    }

    fn send(&mut self, mut message: Value) {
        message["jsonrpc"] = json!("2.0");
        let text = message.to_string();
        write!(self.stdin, "Content-Length: {}\r\n\r\n{text}", text.len()).unwrap();
        self.stdin.flush().unwrap();
    }

    fn read(&mut self) -> Value {
        let mut length = 0;
        loop {
            let mut line = String::new();
            assert!(
                self.stdout.read_line(&mut line).unwrap() > 0,
                "the server has ended"
            );
            match line.trim().split_once(": ") {
                Some(("Content-Length", bytes)) => length = bytes.parse().unwrap(),
                Some(_) => {}
                None => break,
            }
        }
        let mut text = vec![0; length];
        self.stdout.read_exact(&mut text).unwrap();
        serde_json::from_slice(&text).unwrap()
    }

    fn wait_for(&mut self, is_meant: impl Fn(&Value) -> bool) -> Value {
        loop {
            let message = self.read();
            if is_meant(&message) {
                return message;
            }
        }
    }

    fn tell(&mut self, method: &str, params: &Value) {
        self.send(json!({"method": method, "params": params}));
    }

    /// The time of the program when it is known.
    fn time(&mut self, uri: &str) -> String {
        loop {
            self.wait_for(|message| message["method"] == "workspace/codeLens/refresh");
            let params = json!({"textDocument": {"uri": uri}});
            self.send(json!({"id": 2, "method": "textDocument/codeLens", "params": params}));
            let answer = self.wait_for(|message| message["id"] == 2);
            let title = answer["result"][0]["command"]["title"]
                .as_str()
                .unwrap()
                .to_owned();
            if title != "time: ..." {
                return title;
            }
        }
    }
}

#[test]
fn the_server_finds_times_and_ends_over_standard_input_and_output() {
    let machine = Machine::new("");
    machine.write("1000.nc", "G04 P500\nM99\n");
    let uri = format!("file://{}", machine.path("main.nc").display());
    let mut editor = Editor::new(&machine);
    let text = "G90 G54\nG04 P1000\nM98 P1000\nG05\nM30\n";
    let item = json!({"uri": uri, "languageId": "nc", "version": 1, "text": text});
    editor.tell("textDocument/didOpen", &json!({"textDocument": item}));
    let found = editor.wait_for(|message| message["method"] == "textDocument/publishDiagnostics");
    assert_eq!(found["params"]["diagnostics"][0]["range"]["start"]["line"], 3);
    assert_eq!(editor.time(&uri), "no time: correct the errors first");
    let change = |editor: &mut Editor, version: i32, text: &str| {
        let item = json!({"uri": uri, "version": version});
        let params = json!({"textDocument": item, "contentChanges": [{"text": text}]});
        editor.tell("textDocument/didChange", &params);
    };
    // an endless program is simulated until the next change
    change(&mut editor, 2, "while (1 == 1) {\n    G04 P1\n}\nM30\n");
    let checked = |message: &Value| message["params"]["version"] == 2;
    editor.wait_for(checked);
    change(&mut editor, 3, &text.replace("G05\n", ""));
    let title = editor.time(&uri);
    let seconds: f64 = title
        .strip_prefix("takes ")
        .and_then(|rest| rest.strip_suffix(" s"))
        .unwrap()
        .parse()
        .unwrap();
    assert!((1.5..1.6).contains(&seconds), "two dwells: {title}");
    change(
        &mut editor,
        4,
        "G90 G54 G01 F600\nif (P5 == 0) {\nX2000\n}\nM30\n",
    );
    let title = editor.time(&uri);
    assert!(
        title.starts_with("stops after 0.") && title.contains("in line 3: alarm"),
        "{title}"
    );
    machine.write("1000.nc", "G04 P500\nG05\nM99\n");
    change(&mut editor, 5, "M98 P1000\nM30\n");
    let title = editor.time(&uri);
    assert_eq!(title, "no time: 1000.nc, line 2: there is no G5");
    // an invalid message does not end the server
    write!(editor.stdin, "Content-Length: 5\r\n\r\n{{{{{{{{{{").unwrap();
    let told = editor.wait_for(|message| message["method"] == "window/logMessage");
    let text = told["params"]["message"].as_str().unwrap();
    assert!(text.contains("not valid JSON-RPC"), "{text}");
    editor.send(json!({"id": 3, "method": "shutdown"}));
    editor.wait_for(|message| message["id"] == 3);
    editor.tell("exit", &json!(null));
    assert_eq!(editor.child.wait().unwrap().code(), Some(0));
}
