use std::fs;
use std::path::PathBuf;
use std::thread::JoinHandle;
use std::time::Duration;

use lsp_server::{Connection, Message, Notification, Request};
use serde_json::{Value, json};
use tandem_interp::Dialect;
use tandem_interp::dialects::dgshape;
use tempfile::TempDir;

use super::server::serve;
use super::setup::Setup;

/// A simulated editor with a folder of programs.
struct Editor {
    connection: Connection,
    server: JoinHandle<anyhow::Result<bool>>,
    folder: TempDir,
    requests: i32,
}

impl Editor {
    /// Starts an editor; `files` are the names and texts of the files in its folder.
    fn new(files: &[(&str, &str)], dialect: Option<&'static Dialect>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            fs::write(folder.path().join(name), text).unwrap();
        }
        let (connection, other) = Connection::memory();
        // The command does not exist, so the server simulates no program.
        let setup = Setup::new(None, dialect);
        let server = std::thread::spawn(move || serve(&other, setup, PathBuf::from("/no/such/command")));
        let mut editor = Self {
            connection,
            server,
            folder,
            requests: 0,
        };
        editor.ask("initialize", json!({"capabilities": {}}));
        editor.notify_server("initialized", json!({}));
        editor
    }

    fn uri(&self, name: &str) -> String {
        format!("file://{}", self.folder.path().join(name).display())
    }

    fn notify_server(&self, method: &str, params: Value) {
        let notice = Notification::new(method.to_owned(), params);
        self.connection.sender.send(notice.into()).unwrap();
    }

    /// Returns the result of a request, or its error.
    fn ask(&mut self, method: &str, params: Value) -> Value {
        self.requests += 1;
        let id = self.requests.into();
        let request = Request::new(id, method.to_owned(), params);
        let id = request.id.clone();
        self.connection.sender.send(request.into()).unwrap();
        loop {
            if let Message::Response(answer) = self.next()
                && answer.id == id
            {
                let error = |error: lsp_server::ResponseError| json!({"code": error.code});
                return answer.response_result.unwrap_or_else(error);
            }
        }
    }

    fn next(&self) -> Message {
        self.connection
            .receiver
            .recv_timeout(Duration::from_mins(1))
            .unwrap()
    }

    fn open(&self, name: &str, text: &str) {
        let item = json!({"uri": self.uri(name), "languageId": "nc", "version": 1, "text": text});
        self.notify_server("textDocument/didOpen", json!({"textDocument": item}));
    }

    fn change(&self, name: &str, version: i32, changes: &Value) {
        let item = json!({"uri": self.uri(name), "version": version});
        self.notify_server(
            "textDocument/didChange",
            json!({"textDocument": item, "contentChanges": changes}),
        );
    }

    /// Returns the next diagnostics: the document version, and the codes with their ranges.
    fn diagnostics(&self) -> (Value, Vec<(String, [u64; 4])>) {
        loop {
            if let Message::Notification(notice) = self.next()
                && notice.method == "textDocument/publishDiagnostics"
            {
                let found = notice.params["diagnostics"].as_array().unwrap();
                let of = |one: &Value| (one["code"].as_str().unwrap().to_owned(), range(&one["range"]));
                return (notice.params["version"].clone(), found.iter().map(of).collect());
            }
        }
    }

    fn at(&self, name: &str, line: u32, character: u32) -> Value {
        json!({
            "textDocument": {"uri": self.uri(name)},
            "position": {"line": line, "character": character},
        })
    }

    fn of(&self, name: &str) -> Value {
        json!({"textDocument": {"uri": self.uri(name)}})
    }

    fn layout(&mut self) -> Value {
        let mut params = self.of("a.nc");
        params["options"] = json!({"tabSize": 2, "insertSpaces": false});
        self.ask("textDocument/formatting", params)
    }

    fn hover(&mut self, line: u32, character: u32) -> String {
        let answer = self.ask("textDocument/hover", self.at("a.nc", line, character));
        answer["contents"]["value"]
            .as_str()
            .unwrap_or_default()
            .to_owned()
    }

    fn labels(&mut self, line: u32, character: u32) -> Vec<String> {
        let answer = self.ask("textDocument/completion", self.at("a.nc", line, character));
        let items = answer.as_array().unwrap().iter();
        items
            .map(|item| item["label"].as_str().unwrap().to_owned())
            .collect()
    }
}

fn range(range: &Value) -> [u64; 4] {
    let of = |end: &str, part: &str| range[end][part].as_u64().unwrap();
    [
        of("start", "line"),
        of("start", "character"),
        of("end", "line"),
        of("end", "character"),
    ]
}

#[test]
fn findings_come_while_typing_with_the_version_and_utf_16_columns() {
    let editor = Editor::new(&[], None);
    editor.open("a.nc", "G90\n/* \u{1f600} */ G00 X1 X2\nM30\n");
    assert_eq!(
        editor.diagnostics(),
        (json!(1), vec![("E0105".to_owned(), [1, 16, 1, 18])])
    );
    // The change replaces the second X by a Y, then removes one line and inserts one.
    let y = json!({"range": {"start": {"line": 1, "character": 16}, "end": {"line": 1, "character": 17}}, "text": "Y"});
    let cut = json!({"range": {"start": {"line": 0, "character": 0}, "end": {"line": 1, "character": 0}}, "text": ""});
    let more = json!({"range": {"start": {"line": 1, "character": 99}, "end": {"line": 1, "character": 99}}, "text": "\nG01"});
    editor.change("a.nc", 2, &json!([y, cut]));
    editor.change("a.nc", 3, &json!([more]));
    let (version, found) = editor.diagnostics();
    assert_eq!(version, 3, "two changes at once are checked once");
    assert_eq!(
        found.iter().map(|one| one.0.as_str()).collect::<Vec<_>>(),
        ["W0002"]
    );
    editor.change("a.nc", 4, &json!([{"text": "G00 X1\nM30\n"}]));
    assert_eq!(editor.diagnostics(), (json!(4), vec![]));
    editor.notify_server("textDocument/didClose", editor.of("a.nc"));
    assert_eq!(editor.diagnostics(), (Value::Null, vec![]));
}

#[test]
fn a_save_checks_the_open_programs_that_call_what_is_there_now() {
    let editor = Editor::new(&[], None);
    editor.open("a.nc", "M98 P1000\nM30\n");
    assert_eq!(editor.diagnostics().1.len(), 1, "1000 is not there");
    fs::write(editor.folder.path().join("1000.nc"), "M99\n").unwrap();
    editor.notify_server("textDocument/didSave", editor.of("a.nc"));
    assert_eq!(editor.diagnostics().1, []);
}

#[test]
fn hover_says_what_explain_says_of_words_and_findings() {
    let mut editor = Editor::new(&[], None);
    editor.open(
        "a.nc",
        "N10 g1 X[L12] F100 // G02\nif (L1 == 2) L2 = sind(3)\nG00 X1 X2\nM30\n",
    );
    editor.diagnostics();
    for (at, page) in [
        ((0, 5), "G01: "),
        ((0, 4), "G01: "),
        ((0, 7), "X: "),
        ((0, 10), "L: variables"),
        ((0, 15), "F: "),
        ((1, 0), "if: "),
        ((1, 19), "sind: the sine"),
        ((3, 0), "M30: "),
    ] {
        let shown = editor.hover(at.0, at.1);
        assert!(shown.starts_with(page), "{at:?}: {shown}");
    }
    assert!(editor.hover(2, 7).contains("E0105: "));
    for nothing in [(0, 22), (0, 6), (1, 3), (99, 99)] {
        assert_eq!(editor.hover(nothing.0, nothing.1), "", "{nothing:?}");
    }
}

#[test]
fn completion_offers_words_of_preceding_codes_codes_and_program_codes() {
    let mut editor = Editor::new(&[], None);
    editor.open("a.nc", "G04 \n\n// G0 \nG02 X1 \nL1 = \nif (\nX[\n");
    assert_eq!(editor.labels(0, 4)[..2], ["F", "P"], "of G04");
    let of_arc = editor.labels(3, 7);
    assert!(
        ["R", "F", "S", "ts"]
            .iter()
            .all(|word| of_arc.iter().any(|one| one == word)),
        "{of_arc:?}"
    );
    for (line, column) in [(4, 5), (5, 4)] {
        let all = editor.labels(line, column);
        assert_eq!(all[..4], ["L", "Q", "P", "_CNC_CapturedPosition"]);
        assert!(
            all.iter().any(|one| one == "sind") && all.iter().all(|one| one != "X"),
            "{all:?}"
        );
    }
    assert_eq!(editor.labels(6, 2), ["L", "Q", "P", "_CNC_CapturedPosition"]);
    let all = editor.labels(1, 0);
    for label in ["X", "F", "G84", "M30", "while", "atan2d"] {
        assert!(
            all.iter().any(|one| one == label),
            "{label} is missing in {all:?}"
        );
    }
    assert!(editor.labels(2, 5).is_empty(), "in a comment");
}

#[test]
fn the_nearest_configuration_says_dialect_axes_and_m_codes() {
    let config = include_str!("../../../../examples/config/dgshape.toml");
    let mut editor = Editor::new(&[("tandem.toml", config)], None);
    editor.open("a.nc", "%\nO0001 (one)\nG00 X1.0\nM30\n");
    assert_eq!(editor.diagnostics().1, []);
    let all = editor.labels(3, 0);
    assert!(all.iter().any(|label| label == "G83") && all.iter().all(|label| label != "while"));
    fs::write(editor.folder.path().join("tandem.toml"), "[machine]\nname = 5\n").unwrap();
    editor.notify_server("textDocument/didSave", editor.of("a.nc"));
    let warned = loop {
        if let Message::Notification(notice) = editor.next()
            && notice.method == "window/showMessage"
        {
            break notice.params["message"].as_str().unwrap().to_owned();
        }
    };
    assert!(warned.contains("tandem.toml"), "{warned}");
}

#[test]
fn completion_offers_the_m_codes_of_the_machine() {
    let config = include_str!("../../../../examples/config/demo.toml");
    let lines = config.split_inclusive('\n');
    let config: String = lines.filter(|line| !line.contains(".nc\"")).collect();
    let mut editor = Editor::new(&[("tandem.toml", &config)], None);
    editor.open("a.nc", "\n");
    let answer = editor.ask("textDocument/completion", editor.at("a.nc", 0, 0));
    let of_machine = |item: &&Value| item["detail"].as_str().unwrap().starts_with("output of ");
    let outputs: Vec<_> = answer.as_array().unwrap().iter().filter(of_machine).collect();
    assert!(outputs.iter().any(|item| item["label"] == "M100"), "{answer}");
}

#[test]
fn a_call_leads_to_the_file_of_the_subprogram() {
    let mut editor = Editor::new(&[("1000.nc", "M99\n"), ("O1001.nc", "M99\n")], None);
    editor.open("a.nc", "N10 M98 P1000\nM98 P1001 L2\nM98 P1002\nG04 P1000\n");
    for (line, name) in [(0, Some("1000.nc")), (1, Some("O1001.nc")), (2, None), (3, None)] {
        let answer = editor.ask("textDocument/definition", editor.at("a.nc", line, 5));
        assert_eq!(
            answer["uri"].as_str().map(str::to_owned),
            name.map(|name| editor.uri(name))
        );
    }
}

#[test]
fn sections_numbers_and_folds_follow_comments_and_braces() {
    let mut editor = Editor::new(&[], None);
    let text = "// ---- Outside ----\nN10 G00 X1\nwhile (L1 < 2) {\n    N20 X2\n}\n\n/* Bore\nthe hole */\nN30 X3\n// no section\nM30\n";
    editor.open("a.nc", text);
    let symbols = editor.ask("textDocument/documentSymbol", editor.of("a.nc"));
    let names = |list: &Value| -> Vec<String> {
        let list = list.as_array().unwrap().iter();
        list.map(|one| one["name"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(names(&symbols), ["Outside", "Bore"]);
    assert_eq!(names(&symbols[0]["children"]), ["N10", "N20"]);
    assert_eq!(names(&symbols[1]["children"]), ["N30"]);
    let folds = editor.ask("textDocument/foldingRange", editor.of("a.nc"));
    let lines = |one: &Value| {
        (
            one["startLine"].as_u64().unwrap(),
            one["endLine"].as_u64().unwrap(),
        )
    };
    let mut folds: Vec<_> = folds.as_array().unwrap().iter().map(lines).collect();
    folds.sort_unstable();
    assert_eq!(folds, [(0, 4), (2, 3), (6, 7), (6, 10)]);
}

#[test]
fn semantic_tokens_are_those_of_the_language() {
    let mut editor = Editor::new(&[], Some(dgshape()));
    editor.open("a.nc", "%\nO12 (p)\n/N10 G01 X-1.5 M06 T1\n");
    let tokens = editor.ask("textDocument/semanticTokens/full", editor.of("a.nc"));
    let data: Vec<u64> = tokens["data"]
        .as_array()
        .unwrap()
        .iter()
        .map(|one| one.as_u64().unwrap())
        .collect();
    let expected: [[u64; 5]; 13] = [
        [0, 0, 1, 4, 0],
        [1, 0, 3, 4, 0],
        [0, 4, 3, 0, 0],
        [1, 0, 1, 4, 0],
        [0, 1, 1, 4, 0],
        [0, 1, 2, 4, 0],
        [0, 3, 1, 1, 0],
        [0, 1, 2, 1, 0],
        [0, 3, 1, 3, 0],
        [0, 1, 4, 5, 0],
        [0, 5, 1, 2, 0],
        [0, 1, 2, 2, 0],
        [0, 3, 1, 2, 0],
    ];
    assert_eq!(data[..65], expected.concat());
    let mut part = editor.of("a.nc");
    part["range"] = json!({"start": {"line": 1, "character": 0}, "end": {"line": 1, "character": 9}});
    let part = editor.ask("textDocument/semanticTokens/range", part);
    assert_eq!(part["data"], json!([1, 0, 3, 4, 0, 0, 4, 3, 0, 0]));
}

#[test]
fn the_layout_is_an_edit_of_the_lines_that_change() {
    let mut editor = Editor::new(&[], None);
    editor.open("a.nc", "G90\ng1x1\nM30\n");
    let edits = editor.layout();
    assert_eq!(edits.as_array().unwrap().len(), 1);
    assert_eq!(
        (range(&edits[0]["range"]), &edits[0]["newText"]),
        ([1, 0, 2, 0], &json!("G1 X1\n"))
    );
    for text in ["G90\nM30\n", "G1 (x\n"] {
        editor.change("a.nc", 2, &json!([{"text": text}]));
        assert_eq!(editor.layout(), json!([]), "{text}");
    }
}

#[test]
fn the_time_is_above_the_first_line_and_says_why_there_is_none() {
    let mut editor = Editor::new(&[], None);
    editor.open("a.nc", "G05\n");
    editor.diagnostics();
    let lenses = editor.ask("textDocument/codeLens", editor.of("a.nc"));
    assert_eq!(lenses[0]["command"]["title"], "no time: correct the errors first");
    assert_eq!(range(&lenses[0]["range"]), [0, 0, 0, 0]);
}

#[test]
fn what_is_not_offered_malformed_or_not_open_is_answered_and_nothing_ends() {
    let mut editor = Editor::new(&[], None);
    assert_eq!(editor.ask("textDocument/rename", json!({}))["code"], -32601);
    assert_eq!(editor.ask("textDocument/hover", json!({"x": 1}))["code"], -32602);
    assert_eq!(
        editor.ask("textDocument/hover", editor.at("a.nc", 0, 0)),
        Value::Null
    );
    editor.notify_server("textDocument/didChange", json!(5));
    editor.notify_server("textDocument/didOpen", json!({}));
    editor.change("a.nc", 1, &json!([{"text": "x"}]));
    editor.notify_server("$/cancelRequest", json!({"id": 1}));
    let backward = json!({"range": {"start": {"line": 9, "character": 9}, "end": {"line": 0, "character": 0}}, "text": "\u{e4}"});
    editor.open("a.nc", "\u{1f600}X1");
    editor.change("a.nc", 2, &json!([backward]));
    editor.diagnostics();
    editor.ask("shutdown", Value::Null);
    editor.notify_server("exit", Value::Null);
    assert!(editor.server.join().unwrap().unwrap(), "it has ended in order");
}

#[test]
fn an_answer_or_a_question_between_shutdown_and_exit_is_no_failure() {
    let mut editor = Editor::new(&[], None);
    editor.ask("shutdown", Value::Null);
    let late = lsp_server::Response::new_ok(1.into(), Value::Null);
    editor.connection.sender.send(late.into()).unwrap();
    assert_eq!(editor.ask("textDocument/hover", json!({}))["code"], -32600);
    editor.notify_server("exit", Value::Null);
    assert!(editor.server.join().unwrap().unwrap(), "it has ended in order");
}

#[test]
fn an_editor_that_goes_without_a_word_ends_the_server() {
    let editor = Editor::new(&[], None);
    drop(editor.connection);
    assert!(!editor.server.join().unwrap().unwrap());
}
