//! Processes the messages of the editor in order. Checks typed text after a short pause in typing.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Context;
use crossbeam_channel::{after, never, select};
use lsp_server::{Connection, ErrorCode, Message, Notification, Request, Response};
use lsp_types::notification::{self, Notification as _};
use lsp_types::request::{self, Request as _};
use lsp_types::{
    CodeLensOptions, CompletionOptions, CompletionResponse, DocumentSymbolResponse, GotoDefinitionResponse,
    HoverProviderCapability, InitializeParams, LogMessageParams, MessageType, OneOf,
    PublishDiagnosticsParams, SemanticTokens, SemanticTokensFullOptions, SemanticTokensLegend,
    SemanticTokensOptions, SemanticTokensRangeResult, SemanticTokensResult, ServerCapabilities,
    ShowMessageParams, TextDocumentSyncCapability, TextDocumentSyncKind, TextDocumentSyncOptions,
    TextDocumentSyncSaveOptions, Uri,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::super::check::check_text;
use super::document::{Document, path_of};
use super::setup::Setup;
use super::timing::Timing;
use super::transport::MALFORMED;
use super::{completion, features, outline};

/// Minimum pause in typing before a check. Reason: one key often causes several messages.
const QUIET_MIN: Duration = Duration::from_millis(10);

/// Maximum pause in typing before a check; the pause increases with the duration of checks.
const QUIET_MAX: Duration = Duration::from_millis(150);

/// Pause in typing after which the server simulates the program.
const SETTLED: Duration = Duration::from_millis(400);

/// Maximum time from the editor's shutdown request to its exit notification.
const EXIT_MAX: Duration = Duration::from_secs(30);

struct Server<'a> {
    connection: &'a Connection,
    setup: Setup,
    /// Open documents by URI.
    documents: BTreeMap<String, Document>,
    /// URIs of the documents that must be checked.
    due: BTreeSet<String>,
    /// Duration of the last check.
    check_took: Duration,
    /// URI of the document to simulate after the pause in typing.
    untimed: Option<String>,
    timing: Timing,
    /// True if the editor requests times again when the server reports new ones.
    refreshes: bool,
    requests: i32,
}

/// Serves an editor until the connection ends. `command` is the path of this executable. Returns true if the
/// editor announced the end.
///
/// # Errors
/// Returns an error if the editor does not follow the protocol, or if the connection is closed.
pub(super) fn serve(connection: &Connection, setup: Setup, command: PathBuf) -> anyhow::Result<bool> {
    let begun = connection.initialize_start();
    let (id, params) = begun.context("no editor has sent the request initialize on standard input")?;
    let params: InitializeParams = serde_json::from_value(params)?;
    let info = json!({"name": "tandem", "version": env!("CARGO_PKG_VERSION")});
    connection.initialize_finish(id, json!({"capabilities": capabilities(), "serverInfo": info}))?;
    let workspace = params.capabilities.workspace;
    let lens = workspace.and_then(|workspace| workspace.code_lens);
    let mut server = Server {
        connection,
        setup,
        documents: BTreeMap::new(),
        due: BTreeSet::new(),
        check_took: Duration::ZERO,
        untimed: None,
        timing: Timing::new(command),
        refreshes: lens.and_then(|lens| lens.refresh_support).unwrap_or_default(),
        requests: 0,
    };
    loop {
        let quiet = server.quiet().map_or_else(never, after);
        select! {
            recv(connection.receiver) -> message => match message {
                Ok(Message::Request(request)) if request.method == request::Shutdown::METHOD => {
                    server.send(Response::new_ok(request.id, Value::Null));
                    return Ok(server.ends());
                }
                Ok(Message::Request(request)) => server.request(request),
                Ok(Message::Notification(notice)) if notice.method == notification::Exit::METHOD => return Ok(false),
                Ok(Message::Notification(notice)) => server.notice(notice),
                Ok(Message::Response(_)) => {}
                Err(_) => return Ok(false),
            },
            recv(server.timing.ended) -> ended => {
                if ended.is_ok_and(|ended| server.timing.accept_result(ended)) {
                    server.refresh_times();
                }
            },
            recv(server.timing.late) -> _ => {
                server.timing.give_up();
                server.refresh_times();
            },
            recv(quiet) -> _ => server.start_next_job(),
        }
    }
}

fn capabilities() -> ServerCapabilities {
    ServerCapabilities {
        text_document_sync: Some(TextDocumentSyncCapability::Options(TextDocumentSyncOptions {
            open_close: Some(true),
            change: Some(TextDocumentSyncKind::INCREMENTAL),
            save: Some(TextDocumentSyncSaveOptions::Supported(true)),
            ..TextDocumentSyncOptions::default()
        })),
        hover_provider: Some(HoverProviderCapability::Simple(true)),
        completion_provider: Some(CompletionOptions::default()),
        definition_provider: Some(OneOf::Left(true)),
        document_symbol_provider: Some(OneOf::Left(true)),
        folding_range_provider: Some(true.into()),
        document_formatting_provider: Some(OneOf::Left(true)),
        code_lens_provider: Some(CodeLensOptions {
            resolve_provider: Some(false),
        }),
        semantic_tokens_provider: Some(
            SemanticTokensOptions {
                legend: SemanticTokensLegend {
                    token_types: outline::TOKEN_TYPES.to_vec(),
                    token_modifiers: Vec::new(),
                },
                full: Some(SemanticTokensFullOptions::Bool(true)),
                range: Some(true),
                ..SemanticTokensOptions::default()
            }
            .into(),
        ),
        ..ServerCapabilities::default()
    }
}

impl Server<'_> {
    /// Returns the pause in typing after which the next pending job starts; `None` if no job is pending.
    fn quiet(&self) -> Option<Duration> {
        if !self.due.is_empty() {
            // The pause grows with the duration of checks, because the user may continue to type during a
            // check.
            return Some((self.check_took / 2).clamp(QUIET_MIN, QUIET_MAX));
        }
        self.untimed.as_ref().map(|_| SETTLED)
    }

    /// Waits for the exit notification of the editor, and returns true if it arrives. Rejects requests
    /// meanwhile, and ignores other messages.
    fn ends(&self) -> bool {
        loop {
            match self.connection.receiver.recv_timeout(EXIT_MAX) {
                Ok(Message::Notification(notice)) if notice.method == notification::Exit::METHOD => {
                    return true;
                }
                Ok(Message::Request(request)) => {
                    let text = "the server is ending".to_owned();
                    self.send(Response::new_err(
                        request.id,
                        ErrorCode::InvalidRequest as i32,
                        text,
                    ));
                }
                Ok(_) => {}
                Err(_) => return false,
            }
        }
    }

    fn send(&self, message: impl Into<Message>) {
        // If the connection is closed, the next receive operation reports that.
        let _ = self.connection.sender.send(message.into());
    }

    fn notify_client<N: notification::Notification>(&self, params: N::Params) {
        self.send(Notification::new(N::METHOD.to_owned(), params));
    }

    fn request(&self, request: Request) {
        let answer = match request.method.as_str() {
            request::HoverRequest::METHOD => {
                self.answer::<request::HoverRequest>(request, |server, params| {
                    let at = params.text_document_position_params;
                    features::hover(server.document(&at.text_document.uri)?, at.position)
                })
            }
            request::Completion::METHOD => self.answer::<request::Completion>(request, |server, params| {
                let at = params.text_document_position;
                let document = server.document(&at.text_document.uri)?;
                Some(CompletionResponse::Array(completion::completion(
                    document,
                    at.position,
                )))
            }),
            request::GotoDefinition::METHOD => {
                self.answer::<request::GotoDefinition>(request, |server, params| {
                    let at = params.text_document_position_params;
                    let found = features::definition(server.document(&at.text_document.uri)?, at.position);
                    found.map(GotoDefinitionResponse::Scalar)
                })
            }
            request::Formatting::METHOD => self.answer::<request::Formatting>(request, |server, params| {
                Some(features::formatting(server.document(&params.text_document.uri)?))
            }),
            request::DocumentSymbolRequest::METHOD => {
                self.answer::<request::DocumentSymbolRequest>(request, |server, params| {
                    let symbols = outline::symbols(server.document(&params.text_document.uri)?);
                    Some(DocumentSymbolResponse::Nested(symbols))
                })
            }
            request::FoldingRangeRequest::METHOD => self
                .answer::<request::FoldingRangeRequest>(request, |server, params| {
                    Some(outline::folding(server.document(&params.text_document.uri)?))
                }),
            request::CodeLensRequest::METHOD => {
                self.answer::<request::CodeLensRequest>(request, |server, params| {
                    let document = server.document(&params.text_document.uri)?;
                    Some(vec![server.timing.lens(document)])
                })
            }
            _ => self.semantic_tokens(request),
        };
        self.send(answer);
    }

    fn semantic_tokens(&self, request: Request) -> Response {
        let tokens = |document: &Document, first, last| SemanticTokens {
            result_id: None,
            data: outline::semantic_tokens(document, first, last),
        };
        match request.method.as_str() {
            request::SemanticTokensFullRequest::METHOD => {
                self.answer::<request::SemanticTokensFullRequest>(request, |server, params| {
                    let document = server.document(&params.text_document.uri)?;
                    Some(SemanticTokensResult::Tokens(tokens(document, 0, u32::MAX)))
                })
            }
            request::SemanticTokensRangeRequest::METHOD => self
                .answer::<request::SemanticTokensRangeRequest>(request, |server, params| {
                    let document = server.document(&params.text_document.uri)?;
                    let (first, last) = (params.range.start.line, params.range.end.line);
                    Some(SemanticTokensRangeResult::Tokens(tokens(document, first, last)))
                }),
            method => {
                let text = format!("{method} is not supported");
                Response::new_err(request.id, ErrorCode::MethodNotFound as i32, text)
            }
        }
    }

    /// Answers a request with the result of `answer`, or with an error if the parameters are invalid.
    fn answer<R: request::Request>(
        &self,
        request: Request,
        answer: impl FnOnce(&Self, R::Params) -> R::Result,
    ) -> Response
    where
        R::Params: DeserializeOwned,
        R::Result: Serialize,
    {
        match serde_json::from_value(request.params) {
            Ok(params) => Response::new_ok(request.id, answer(self, params)),
            Err(error) => Response::new_err(request.id, ErrorCode::InvalidParams as i32, error.to_string()),
        }
    }

    fn document(&self, uri: &Uri) -> Option<&Document> {
        self.documents.get(uri.as_str())
    }

    /// Handles a notification; ignores unknown or malformed notifications.
    fn notice(&mut self, notice: Notification) {
        match notice.method.as_str() {
            notification::DidOpenTextDocument::METHOD => {
                let Some(params) = params::<notification::DidOpenTextDocument>(notice) else {
                    return;
                };
                self.open(params.text_document);
            }
            notification::DidChangeTextDocument::METHOD => {
                let Some(params) = params::<notification::DidChangeTextDocument>(notice) else {
                    return;
                };
                let uri = params.text_document.uri.as_str().to_owned();
                if let Some(document) = self.documents.get_mut(&uri) {
                    document.version = params.text_document.version;
                    params
                        .content_changes
                        .into_iter()
                        .for_each(|change| document.change(change));
                    self.timing.forget(&uri);
                    self.due.insert(uri);
                }
            }
            // The saved program may call other open programs, or they may call it, so all are checked.
            notification::DidSaveTextDocument::METHOD => self.due.extend(self.documents.keys().cloned()),
            notification::DidCloseTextDocument::METHOD => {
                let Some(params) = params::<notification::DidCloseTextDocument>(notice) else {
                    return;
                };
                let uri = params.text_document.uri;
                self.documents.remove(uri.as_str());
                self.due.remove(uri.as_str());
                self.timing.forget(uri.as_str());
                self.notify_client::<notification::PublishDiagnostics>(PublishDiagnosticsParams::new(
                    uri,
                    Vec::new(),
                    None,
                ));
            }
            MALFORMED => self.notify_client::<notification::LogMessage>(LogMessageParams {
                typ: MessageType::ERROR,
                message: notice.params.as_str().unwrap_or_default().to_owned(),
            }),
            _ => {}
        }
    }

    fn open(&mut self, opened: lsp_types::TextDocumentItem) {
        let (target, wrong) = self.setup.target(&path_of(&opened.uri));
        self.warn(wrong);
        let uri = opened.uri.as_str().to_owned();
        let document = Document::new(opened.uri, opened.version, opened.text, target);
        self.documents.insert(uri.clone(), document);
        self.due.insert(uri);
    }

    fn warn(&self, wrong: Option<String>) {
        if let Some(message) = wrong {
            self.notify_client::<notification::ShowMessage>(ShowMessageParams {
                typ: MessageType::WARNING,
                message,
            });
        }
    }

    /// Starts the next pending job: first a check, then a simulation.
    fn start_next_job(&mut self) {
        if self.due.is_empty() {
            self.start_timing();
        } else {
            self.check_due();
        }
    }

    /// Checks the changed documents, and publishes their diagnostics.
    fn check_due(&mut self) {
        let begun = Instant::now();
        for uri in std::mem::take(&mut self.due) {
            let Some(document) = self.documents.get_mut(&uri) else {
                continue;
            };
            let (target, wrong) = self.setup.target(&document.path);
            let (dialect, machine) = (target.dialect, target.machine.clone());
            document.target = target;
            let assigned = machine
                .as_deref()
                .and_then(|machine| machine.system_of_program(&document.path));
            let all = check_text(
                &document.path,
                document.text(),
                dialect,
                machine.as_deref(),
                assigned,
            );
            // Diagnostics of called programs are only shown in the documents of those programs, if these are
            // open.
            document.found = all
                .into_iter()
                .next()
                .map(|own| own.diagnostics)
                .unwrap_or_default();
            if document.found.iter().any(tandem_model::Diagnostic::is_error) {
                self.timing.refuse(&uri);
                self.untimed.take_if(|untimed| *untimed == uri);
            } else {
                self.untimed = Some(uri.clone());
            }
            let document = &self.documents[&uri];
            let found = features::diagnostics(document);
            let params = PublishDiagnosticsParams::new(document.uri.clone(), found, Some(document.version));
            self.notify_client::<notification::PublishDiagnostics>(params);
            self.warn(wrong);
        }
        self.check_took = begun.elapsed();
        self.refresh_times();
    }

    /// Starts the simulation of the program that was checked last without errors.
    fn start_timing(&mut self) {
        let uri = self.untimed.take();
        if let Some(document) = uri.and_then(|uri| self.documents.get(&uri)) {
            self.timing.start(document);
        }
    }

    fn refresh_times(&mut self) {
        if self.refreshes {
            self.requests += 1;
            let method = request::CodeLensRefresh::METHOD.to_owned();
            self.send(Request::new(self.requests.into(), method, Value::Null));
        }
    }
}

fn params<N: notification::Notification>(notice: Notification) -> Option<N::Params>
where
    N::Params: DeserializeOwned,
{
    notice.extract(N::METHOD).ok()
}
