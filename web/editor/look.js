// The editor in the colours of the screen: the shadow root inherits the variables of the page, in both themes.

/** @typedef {import("../vendor/codemirror.js")} CodeMirror */

/** Kinds of words, as their parser names them. @param {CodeMirror} cm */
export function coloursOf({ tags }) {
  return { comment: tags.comment, n: tags.labelName, g: tags.keyword, m: tags.macroName, axis: tags.propertyName, variable: tags.variableName, keyword: tags.controlKeyword, number: tags.number, other: tags.operator };
}

/** @param {CodeMirror} cm */
export function themeOf(cm) {
  const { tags } = cm;
  const colours = cm.HighlightStyle.define([
    { tag: tags.comment, color: "var(--muted)", fontStyle: "italic" },
    { tag: tags.labelName, color: "var(--muted)" },
    { tag: tags.keyword, color: "var(--accent)" },
    { tag: tags.macroName, color: "var(--attention)" },
    { tag: tags.propertyName, color: "var(--active)" },
    { tag: tags.variableName, color: "var(--ended)" },
    { tag: tags.controlKeyword, color: "var(--ended)", fontWeight: "600" },
  ]);
  return [cm.syntaxHighlighting(colours), cm.EditorView.theme(RULES)];
}

const BUTTON = { minHeight: "var(--target)", minWidth: "var(--target)", padding: "0 10px", border: "1px solid var(--line)", borderRadius: "8px", background: "var(--raised)", color: "var(--text)", font: "inherit", fontWeight: "600" };

/** @type {Parameters<CodeMirror["EditorView"]["theme"]>[0]} */
const RULES = {
  "&": { height: "100%", color: "var(--text)", background: "var(--card)", fontSize: "14px" },
  "&.cm-focused": { outline: "3px solid var(--accent)", outlineOffset: "-3px" },
  ".cm-scroller": { fontFamily: "var(--mono)", lineHeight: "22px", overflow: "auto" },
  ".cm-content": { caretColor: "var(--text)" },
  ".cm-gutters": { background: "var(--raised)", color: "var(--muted)", borderRight: "1px solid var(--line)" },
  ".cm-activeLine": { background: "color-mix(in srgb, var(--raised) 60%, transparent)" },
  ".cm-activeLineGutter": { background: "var(--raised)", color: "var(--text)", fontWeight: "700" },
  ".cm-selectionMatch": { background: "var(--attention-soft)" },
  ".cm-searchMatch": { background: "var(--attention-soft)", outline: "1px solid var(--attention)" },
  ".cm-searchMatch-selected": { background: "var(--wait-soft)", outline: "2px solid var(--wait)" },
  ".cm-panels": { background: "var(--card)", color: "var(--text)", borderBottom: "1px solid var(--line)" },
  ".cm-panel.cm-search": { display: "flex", flexWrap: "wrap", alignItems: "center", gap: "6px", padding: "8px calc(var(--target) + 16px) 8px 8px" },
  ".cm-panel.cm-search br": { display: "none" },
  ".cm-panel.cm-search label": { display: "inline-flex", alignItems: "center", gap: "6px", minHeight: "var(--target)", margin: "0", fontSize: "14px" },
  ".cm-panel.cm-search input[type=checkbox]": { width: "22px", height: "22px", margin: "0", accentColor: "var(--accent)" },
  ".cm-panel.cm-search .cm-textfield": { flex: "1 1 180px", minWidth: "0" },
  ".cm-textfield": { minHeight: "var(--target)", margin: "0", padding: "0 10px", border: "1px solid var(--line)", borderRadius: "8px", background: "var(--card)", color: "var(--text)", fontSize: "15px" },
  ".cm-button": { ...BUTTON, margin: "0", backgroundImage: "none" },
  ".cm-panel.cm-search [name=close]": { ...BUTTON, top: "8px", right: "8px", fontSize: "22px" },
  ".cm-gutter-lint": { width: "22px" },
  ".cm-gutter-lint .cm-gutterElement": { padding: "0 3px" },
  // the content security policy forbids the kind of pictures that CodeMirror uses for its signs
  ".cm-lint-marker": { content: "normal", width: "16px", height: "16px", lineHeight: "16px", marginTop: "3px", borderRadius: "4px", textAlign: "center", fontWeight: "700", fontSize: "12px", color: "var(--on-tone)" },
  ".cm-lint-marker-error": { content: "normal", background: "var(--alarm)" },
  ".cm-lint-marker-error::before": { content: "'✕'" },
  ".cm-lint-marker-warning": { content: "normal", background: "var(--attention)" },
  ".cm-lint-marker-warning::before": { content: "'!'" },
  ".cm-lintRange": { backgroundImage: "none", paddingBottom: "0", textDecoration: "underline wavy 1.5px", textUnderlineOffset: "3px" },
  ".cm-lintRange-error": { backgroundImage: "none", textDecorationColor: "var(--alarm)" },
  ".cm-lintRange-warning": { backgroundImage: "none", textDecorationColor: "var(--attention)" },
  ".cm-lintPoint::after": { borderBottomColor: "var(--alarm)" },
  ".cm-tooltip": { background: "var(--card)", color: "var(--text)", border: "1px solid var(--muted)", borderRadius: "8px", maxWidth: "480px", fontSize: "14px" },
  ".meaning-tip": { maxHeight: "260px", overflow: "auto", padding: "8px 12px" },
  ".meaning-tip p": { margin: "6px 0 0" },
  ".meaning-tip pre": { margin: "6px 0 0", fontFamily: "var(--mono)", fontSize: "13px", whiteSpace: "pre-wrap" },
  ".meaning-tip img": { maxWidth: "100%" },
  ".cm-diagnostic": { padding: "8px 12px", borderLeftWidth: "5px", whiteSpace: "pre-wrap" },
  ".cm-diagnostic-error": { borderLeftColor: "var(--alarm)" },
  ".cm-diagnostic-warning": { borderLeftColor: "var(--attention)" },
  ".cm-changedLine": { background: "var(--active-soft)" },
  ".cm-deletedChunk": { background: "var(--alarm-soft)" },
  ".cm-changedText": { background: "color-mix(in srgb, var(--active) 30%, transparent)" },
  ".cm-deletedChunk .cm-deletedText": { background: "color-mix(in srgb, var(--alarm) 30%, transparent)" },
  ".cm-changedLineGutter": { background: "var(--active)" },
  ".cm-deletedLineGutter": { background: "var(--alarm)" },
  ".cm-collapsedLines": { background: "var(--wait-soft)", color: "var(--wait)", minHeight: "28px" },
  ".cm-collapsedLines:before, .cm-collapsedLines:after": { content: "'⋯'" },
};
