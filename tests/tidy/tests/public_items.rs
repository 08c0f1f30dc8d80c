//! The public items of `plc-api`, the crate for machine builders: their number, and an example or a reason for each.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use proc_macro2::{TokenStream, TokenTree};
use regex::Regex;
use syn::{ImplItem, Item, TraitItem, UseTree, Visibility};
use tandem_tidy::product::{parse, sources};
use tandem_tidy::{files, read};

/// Number of public items. If you add an item, add its example, and raise this number in the same commit.
const PUBLIC_ITEMS: usize = 463;

/// Macros whose calls declare public items, one for each line.
const DECLARING_MACROS: [&str; 5] = ["readings", "calls", "values", "letters", "unit"];

/// Items without an example, by reason. An item with an example must not be in this list.
const WITHOUT_EXAMPLE: [(&str, &[&str]); 13] = [
    (
        "a unit, used as `KiloNewton` in the examples of `units`",
        &[
            "Bar",
            "Celsius",
            "Degree",
            "Millimetre",
            "Millisecond",
            "Newton",
            "NewtonMetre",
            "Percent",
            "RevolutionPerMinute",
            "Second",
        ],
    ),
    (
        "a parameter, used as `Va`",
        &["Vb", "Vc", "Vd", "Ve", "Vf", "Vg", "Vh"],
    ),
    (
        "a function block or its part, used as `OnDelay` and `RisingEdge`",
        &[
            "DownCounter",
            "DownCounter.set_preset",
            "FallingEdge",
            "OffDelay",
            "OffDelay.elapsed",
            "OffDelay.set_preset",
            "OnDelay.elapsed",
            "OnDelay.set_preset",
            "Pulse",
            "Pulse.elapsed",
            "Pulse.set_preset",
            "ResetDominant",
            "SetDominant",
            "UpCounter.set_preset",
            "UpDownCounter",
            "UpDownCounter.q_down",
            "UpDownCounter.q_up",
            "UpDownCounter.set_preset",
        ],
    ),
    (
        "a command or input of an operator panel: one call, used as `start` and `set_interlock`",
        &[
            "CoordinateSystem.back_trace",
            "CoordinateSystem.home",
            "CoordinateSystem.interlock_while_here",
            "CoordinateSystem.jog",
            "CoordinateSystem.jog_end",
            "CoordinateSystem.mdi",
            "CoordinateSystem.mdi_macro",
            "CoordinateSystem.set_dry_run",
            "CoordinateSystem.set_interlock_source",
            "CoordinateSystem.set_optional_skip",
            "CoordinateSystem.set_optional_stop",
            "CoordinateSystem.set_single_block",
            "CoordinateSystem.set_spindle",
            "CoordinateSystem.set_start_lock",
            "CoordinateSystem.set_start_lock_source",
            "CoordinateSystem.start_from",
            "Plc.set_skip_input",
        ],
    ),
    (
        "a reading of a coordinate system or a machine: one call, used as `state`",
        &[
            "CoordinateSystem.last_run",
            "CoordinateSystem.lease",
            "CoordinateSystem.line_state",
            "CoordinateSystem.modal",
            "CoordinateSystem.newest_run",
            "CoordinateSystem.number",
            "CoordinateSystem.optional_skip",
            "CoordinateSystem.questions",
            "CoordinateSystem.runs",
            "CoordinateSystem.spindle",
            "Plc.is_online",
            "Plc.journal",
            "Plc.programs",
        ],
    ),
    (
        "a flag that a scan reads or writes: one call, used as `is_on` and `reset`",
        &[
            "Image.execution",
            "Image.io",
            "Image.is_dry_run",
            "Image.is_optional_skip",
            "Image.is_optional_stop",
            "Image.is_single_block",
            "Image.last_scan_s",
            "Image.late_scans",
            "Image.longest_scan_s",
            "Image.modal",
            "Image.optional_skip",
            "Image.overruns",
            "Image.refusals",
            "Image.scans",
            "Image.set_interlock_source",
            "Image.set_io_in",
            "Image.set_optional_skip",
            "Image.set_optional_stop",
            "Image.set_q",
            "Image.set_single_block",
            "Image.set_skip_input",
            "Image.set_spindle",
            "Image.set_start_lock",
            "Image.set_start_lock_source",
            "Image.spindle",
        ],
    ),
    (
        "a setting of a sequence or scan program: one call, used as `handler_id`",
        &[
            "ScanProgram::cycle_limit",
            "SequenceProgram.ends_within",
            "SequenceProgram.returns_within",
        ],
    ),
    (
        "a limit, which its text states",
        &["INTERVAL_MIN", "SCAN_PERIOD_MIN"],
    ),
    (
        "the type of a value that a method with an example takes or returns; programs use its fields",
        &[
            "AlarmRecord",
            "AlarmSeverity",
            "AlarmWords",
            "Approach",
            "BootId",
            "CallSite",
            "CapturedPositions",
            "CoordinateSystemNumber",
            "DeclaredParams",
            "DiagnosticSeverity",
            "HandlerPresence",
            "HandshakeStatus",
            "Input",
            "IoForced",
            "IoKind",
            "IoLoss",
            "IoSide",
            "IoStart",
            "IoState",
            "IoValue",
            "LastRun",
            "LeaseState",
            "LineStart",
            "LineState",
            "Lock",
            "LockSource",
            "Message",
            "Modal",
            "MqttOptions",
            "NotAfter",
            "OptionalSkip",
            "OutputNotice",
            "OutputState",
            "Overrides",
            "ParamLetter",
            "Pending",
            "PendingOutput",
            "Position",
            "Production",
            "ProgramDiagnostic",
            "ProgramInfo",
            "ProgramLocation",
            "Progress",
            "Question",
            "Request",
            "RestoredOutput",
            "Run",
            "RunAlarm",
            "RunEnded",
            "RunKind",
            "RunOrder",
            "RunWait",
            "ServedMCode",
            "ServedMCodesFile",
            "SignatureState",
            "SpindleCommand",
            "SpindleDirection",
            "Switch",
            "Timestamp",
            "Timing",
            "TlsFiles",
            "ToolChange",
            "Verb",
        ],
    ),
    (
        "the type of a guard, a handle or a stream that a method with an example returns; programs do not name it",
        &[
            "Changes",
            "HeartbeatGuard",
            "Interval",
            "Io",
            "IoChanges",
            "LeaseGuard",
            "LockGuard",
            "OpenQuestion",
            "OrderedRun",
            "Outputs",
            "Port",
            "RawOutput",
            "Subscription",
            "Variables",
        ],
    ),
    (
        "a getter or a variant of a method with an example",
        &[
            "AuxOutput.run_id",
            "AuxOutput.seq",
            "Cancellation.cancelled",
            "CoordinateSystem.take_lease_as",
            "CoordinateSystem.work_offset_changes",
            "Io.force",
            "Io.point",
            "LeaseGuard.fence",
            "LeaseGuard.is_lost",
            "MCode.name",
            "Plc.change_tools",
            "Plc.io",
            "Plc.not_after",
            "Plc.tool_changes",
            "Plc::connect_with",
            "RawOutput.notice",
        ],
    ),
    (
        "part of a trait that functions, units and `derive(Params)` implement; programs do not name it",
        &[
            "ByName",
            "ByNumber",
            "Device",
            "DeviceHandler",
            "DeviceHandler::call",
            "Everywhere",
            "FromOutput",
            "FromOutput::from_output",
            "FromOutput::takes",
            "Handler",
            "Handler::call",
            "Handler::takes",
            "InCoordinateSystem",
            "MCodes",
            "MCodes::m_codes",
            "MCodes::names",
            "OneCoordinateSystem",
            "Takes",
            "Takes.no_other_params",
            "Takes.param",
        ],
    ),
    (
        "called by code that macros of this crate generate",
        &["bound()", "param()"],
    ),
];

/// A public item: `Type`, `Type::method`, `function` or `macro!`.
type ItemName = String;

/// Returns true if an item is public outside of the crate.
fn is_public(visibility: &Visibility) -> bool {
    matches!(visibility, Visibility::Public(_))
}

/// Adds the names that a `use` declaration re-exports.
fn add_exports(tree: &UseTree, found: &mut Vec<ItemName>) {
    match tree {
        UseTree::Path(path) => add_exports(&path.tree, found),
        UseTree::Name(name) => found.push(name.ident.to_string()),
        UseTree::Rename(rename) => found.push(rename.rename.to_string()),
        UseTree::Group(group) => group.items.iter().for_each(|tree| add_exports(tree, found)),
        UseTree::Glob(_) => found.push("*".to_owned()),
    }
}

/// Returns the first name of each line of a macro call, without attributes and visibilities.
fn declared_names(tokens: TokenStream) -> Vec<String> {
    let mut names = Vec::new();
    let mut is_first = true;
    for token in tokens {
        match token {
            TokenTree::Ident(name) if is_first && name != "pub" && name != "struct" => {
                names.push(name.to_string());
                is_first = false;
            }
            TokenTree::Punct(mark) if mark.as_char() == ';' => is_first = true,
            _ => {}
        }
    }
    names
}

/// Returns the type of an inherent `impl`, or `None` for another item.
fn own_type(item: &syn::ItemImpl) -> Option<String> {
    let syn::Type::Path(path) = &*item.self_ty else {
        return None;
    };
    let name = path.path.segments.last()?.ident.to_string();
    item.trait_.is_none().then_some(name)
}

/// Adds the public items of a list of items.
fn add_items(items: &[Item], found: &mut Vec<ItemName>) {
    for item in items {
        match item {
            Item::Struct(item) if is_public(&item.vis) => found.push(item.ident.to_string()),
            Item::Enum(item) if is_public(&item.vis) => found.push(item.ident.to_string()),
            Item::Type(item) if is_public(&item.vis) => found.push(item.ident.to_string()),
            Item::Const(item) if is_public(&item.vis) => found.push(item.ident.to_string()),
            Item::Fn(item) if is_public(&item.vis) => found.push(format!("{}()", item.sig.ident)),
            Item::Trait(item) if is_public(&item.vis) => {
                found.push(item.ident.to_string());
                let methods = item.items.iter().filter_map(|inner| match inner {
                    TraitItem::Fn(method) => Some(format!("{}::{}", item.ident, method.sig.ident)),
                    _ => None,
                });
                found.extend(methods);
            }
            Item::Impl(item) => add_methods(item, found),
            Item::Mod(item) if is_public(&item.vis) => {
                let inner = item.content.as_ref().map(|(_, items)| items.as_slice());
                add_items(inner.unwrap_or_default(), found);
            }
            Item::Use(item) if is_public(&item.vis) => {
                if let UseTree::Path(path) = &item.tree
                    && ["plc_protocol", "plc_api_derive"]
                        .iter()
                        .any(|name| path.ident == *name)
                {
                    add_exports(&item.tree, found);
                }
            }
            Item::Macro(item) => add_macro(item, found),
            _ => {}
        }
    }
}

/// Adds the public methods and constants of a type.
fn add_methods(item: &syn::ItemImpl, found: &mut Vec<ItemName>) {
    let Some(owner) = own_type(item) else {
        return;
    };
    for inner in &item.items {
        match inner {
            ImplItem::Fn(method) if is_public(&method.vis) => {
                let is_constructor = method.sig.receiver().is_none();
                let mark = if is_constructor { "::" } else { "." };
                found.push(format!("{owner}{mark}{}", method.sig.ident));
            }
            ImplItem::Const(constant) if is_public(&constant.vis) => {
                found.push(format!("{owner}::{}", constant.ident));
            }
            _ => {}
        }
    }
}

/// Adds an exported macro, or the items that the call of a macro declares.
fn add_macro(item: &syn::ItemMacro, found: &mut Vec<ItemName>) {
    if let Some(name) = &item.ident {
        let is_exported = |attribute: &syn::Attribute| attribute.path().is_ident("macro_export");
        if item.attrs.iter().any(is_exported) {
            found.push(format!("{name}!"));
        }
        return;
    }
    let called = item.mac.path.segments.last().map(|last| last.ident.to_string());
    let Some(called) = called.filter(|called| DECLARING_MACROS.contains(&called.as_str())) else {
        return;
    };
    let owner = match called.as_str() {
        "readings" | "calls" => "CoordinateSystem.",
        "values" => "Image.",
        _ => "",
    };
    let names = declared_names(item.mac.tokens.clone());
    found.extend(names.iter().map(|name| format!("{owner}{name}")));
}

/// Returns the public items of `plc-api`, and how often each is exported.
fn public_items() -> BTreeMap<ItemName, usize> {
    let mut found = Vec::new();
    for source in sources("plc-api/src").into_values() {
        add_items(&parse(&source.path, &source.text).items, &mut found);
    }
    let mut items = BTreeMap::new();
    for item in found {
        *items.entry(item).or_default() += 1;
    }
    items
}

/// Returns the code of the examples in comments of a Rust source.
fn code_of_comments(text: &str) -> String {
    let mut code = String::new();
    let mut is_code = false;
    for line in text.lines().map(str::trim_start) {
        let Some(comment) = line.strip_prefix("///").or_else(|| line.strip_prefix("//!")) else {
            continue;
        };
        let comment = comment.trim_start();
        if comment.starts_with("```") {
            is_code = !is_code;
        } else if is_code {
            code.push_str(comment.trim_start_matches("# "));
            code.push('\n');
        }
    }
    code
}

/// Returns the Rust code of a page of the book.
fn code_of_page(text: &str) -> String {
    let blocks = text.split("\n```rust").skip(1);
    blocks.filter_map(|block| block.split("\n```").next()).collect()
}

/// Returns the code of all examples for machine builders.
fn examples() -> String {
    let is_in = |path: &Path, folder: &str| path.starts_with(folder);
    let mut code = String::new();
    for path in files(&[".rs", ".md", ".rs.txt"]) {
        let of_library = ["plc-api/src", "plc-api/protocol/src"]
            .iter()
            .any(|folder| is_in(&path, folder));
        if of_library && !path.ends_with("tests.rs") {
            code += &code_of_comments(&read(&path));
        } else if is_in(&path, "docs/src") || path == Path::new("README.md") {
            code += &code_of_page(&read(&path));
        } else if is_in(&path, "examples") || is_in(&path, "runtime/src/cli/init") {
            code += &read(&path);
        }
    }
    code
}

/// Returns true if this code uses an item.
fn uses(code: &str, item: &str) -> bool {
    let generic = "(::<[^>]*>)?";
    let pattern = if let Some(name) = item.strip_suffix('!') {
        format!(r"\b{name}!")
    } else if let Some(name) = item.strip_suffix("()") {
        format!(r"\b{name}{generic}\(")
    } else if let Some((_, method)) = item.split_once('.') {
        format!(r"\.{method}{generic}\(")
    } else if let Some((owner, name)) = item.split_once("::") {
        format!(r"\b{owner}{generic}::{name}\b|(\bfn |\.){name}\b")
    } else {
        format!(r"\b{item}\b")
    };
    Regex::new(&pattern).is_ok_and(|pattern| pattern.is_match(code))
}

#[test]
fn each_public_item_of_plc_api_is_counted() {
    let count = public_items().values().sum::<usize>();
    assert_eq!(count, PUBLIC_ITEMS, "public items of plc-api");
}

#[test]
fn plc_api_re_exports_items_by_name_only() {
    assert!(
        !public_items().contains_key("*"),
        "`pub use plc_protocol::...::*`"
    );
}

#[test]
fn each_public_item_of_plc_api_has_an_example_or_a_reason() {
    let (items, examples) = (public_items(), examples());
    let listed: BTreeSet<&str> = WITHOUT_EXAMPLE
        .iter()
        .flat_map(|(_, items)| items.iter().copied())
        .collect();
    let has_example = |item: &str| uses(&examples, item);
    let missing: Vec<_> = items
        .keys()
        .filter(|item| !listed.contains(item.as_str()) && !has_example(item))
        .collect();
    assert!(
        missing.is_empty(),
        "neither an example nor a reason: {missing:#?}"
    );
    let unknown: Vec<_> = listed.iter().filter(|item| !items.contains_key(**item)).collect();
    assert!(unknown.is_empty(), "no public item: {unknown:#?}");
    let superfluous: Vec<_> = listed.iter().filter(|item| has_example(item)).collect();
    assert!(superfluous.is_empty(), "with an example: {superfluous:#?}");
}

#[test]
fn use_of_an_item_in_an_example_is_found() {
    for (item, code) in [
        ("Plc", "plc: Plc"),
        ("Plc.sleep", "plc.sleep(pause)"),
        ("Plc::connect", "Plc::connect(address)"),
        ("stop_signal()", "plc_api::stop_signal()"),
        ("unit!", "plc_api::unit!("),
    ] {
        assert!(uses(code, item), "{item}");
    }
    assert!(!uses("sleep(pause)", "Plc.sleep"));
    let comment = "/// Text: Plc\n/// ```\n/// # let a = 1;\n/// b();\n/// ```\nfn c() {}\n";
    assert_eq!(code_of_comments(comment), "let a = 1;\nb();\n");
    assert_eq!(code_of_page("a\n```rust\nb();\n```\nc\n"), "\nb();");
}
