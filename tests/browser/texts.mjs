// Finds texts for people in the code of the HMI: these texts belong in its language tables.

import ts from "typescript";

/** Properties and attributes without text. */
const TECHNICAL = /^(Authorization|Content-Type|class|id|type|role|name|for|href|src|autocomplete|autocapitalize|inputmode|enterkeyhint|method|download|place|kind|tone|icon|verb|key|tabindex|data-.+|aria-(controls|labelledby|describedby|live|pressed|checked|expanded|selected|current|sort|haspopup|invalid))$/;
/** Properties and attributes with texts for people. */
const READ = /^(aria-(label|description|roledescription|valuetext|placeholder)|title|placeholder|alt|label|text|says|yes|no|about)$/;
/** Calls without text arguments. */
const MECHANICAL = /(^|\.)(t|has|querySelector|querySelectorAll|closest|matches|addEventListener|removeEventListener|getAttribute|setAttribute|hasAttribute|removeAttribute|matchMedia|getItem|setItem|setProperty|removeProperty|define|getContext|getUniformLocation|getAttribLocation|includes|startsWith|endsWith|split|join|replace|replaceAll|match|matchAll|test|RegExp|register|icon|setIcon|createElement|createElementNS|get|set|on|add|keep|request|shape|picture|toggle|remove|contains|postMessage|dispatchEvent|CustomEvent|KeyboardEvent|command|explain|indexOf|lastIndexOf|padStart|padEnd|toLocaleString|DateTimeFormat|NumberFormat)$/;
/** Calls with text arguments: from this argument on, or only this one. */
const SHOWN = { h: 2, button: 1, fill: 1, append: 0 };
const SHOWN_ALONE = { setText: 1, toast: 0, show: 0, Refusal: 0, Error: 0, openDialog: 1, card: 1, text: 2, fillText: 0 };
/** Proper names, which are equal in every language. */
const PROPER = /\b(Tandem|OpenAPI|AsyncAPI|REST|MQTT|QoS|WebSocket|SHA-256|[KM]iB|mm|min|seq|XYZ)\b/g;

const PROSE = /\p{L}[,.:;]? +\p{L}{2}/u;
const CAPITAL = /^[A-Z][a-z]+/;
const WORD = /\p{L}{2,}/u;

/**
 * Returns the texts in a module, with their lines.
 * @param {string} name @param {string} source
 */
export function textsIn(name, source) {
  const file = ts.createSourceFile(name, source, ts.ScriptTarget.ES2023, true, ts.ScriptKind.JS);
  const found = [];
  const visit = (node) => {
    if ((ts.isStringLiteralLike(node) || ts.isTemplateExpression(node)) && isText(node)) found.push(node);
    ts.forEachChild(node, visit);
  };
  visit(file);
  return found.map((node) => ({ line: file.getLineAndCharacterOfPosition(node.getStart()).line + 1, text: node.getText(), from: node.getStart(), to: node.getEnd() }));
}

/** Returns the written text of a node, without its placeholders. */
function written(node) {
  if (!ts.isTemplateExpression(node)) return node.text;
  return [node.head.text, ...node.templateSpans.map((span) => span.literal.text)].join("\u0000");
}

function isText(node) {
  const text = written(node).replace(/<[^>]+>/g, "").replaceAll(PROPER, "");
  if (!WORD.test(text)) return false;
  // style sheets and their values, shaders
  if (/[{};]\s*\n|void main|^\w+\/\w+;|var\(--|:host|\dpx\b/.test(text)) return false;
  const where = placeOf(node);
  if (where === "read") return true;
  return where !== "technical" && (PROSE.test(text) || text.split("\u0000").some((part) => CAPITAL.test(part.trim())));
}

/** Returns the kind of place in which a literal is: read by people, read by the machine, or unknown. */
function placeOf(node) {
  let [child, parent] = [node, node.parent];
  for (; parent; [child, parent] = [parent, parent.parent]) {
    if (ts.isImportDeclaration(parent) || ts.isExportDeclaration(parent) || ts.isCaseClause(parent)) return "technical";
    if (ts.isElementAccessExpression(parent) && parent.argumentExpression === child) return "technical";
    if (ts.isPropertyAssignment(parent)) return parent.name === child ? "technical" : ofName(parent.name.text);
    if (ts.isCallExpression(parent) || ts.isNewExpression(parent)) return ofCall(parent, child);
    if (ts.isBinaryExpression(parent) && /^[=!]==?$|^in$/.test(parent.operatorToken.getText())) return "technical";
    if (ts.isBinaryExpression(parent) && parent.operatorToken.kind === ts.SyntaxKind.EqualsToken && ts.isPropertyAccessExpression(parent.left)) return ofName(parent.left.name.text);
    const goesOn = ts.isConditionalExpression(parent) ? parent.condition !== child : ts.isBinaryExpression(parent) || ts.isParenthesizedExpression(parent) || ts.isArrayLiteralExpression(parent) || ts.isSpreadElement(parent) || ts.isTemplateSpan(parent) || ts.isTemplateExpression(parent);
    if (!goesOn) return "anywhere";
  }
  return "anywhere";
}

function ofName(name = "") {
  if (READ.test(name)) return "read";
  return TECHNICAL.test(name) ? "technical" : "anywhere";
}

function ofCall(call, child) {
  const callee = call.expression.getText();
  if (callee === "import" || MECHANICAL.test(callee)) return "technical";
  const name = callee.split(".").at(-1);
  const at = call.arguments?.indexOf(child) ?? -1;
  if (callee === "setAttr") return at === 2 ? ofName(call.arguments[1]?.text) : "technical";
  // messages about a programmer's mistake
  if (callee === "TypeError") return "technical";
  if (name in SHOWN_ALONE) return SHOWN_ALONE[name] === at ? "read" : "technical";
  return at >= (SHOWN[name] ?? Number.POSITIVE_INFINITY) ? "read" : "anywhere";
}

/** Every literal of a module. @param {string} name @param {string} source */
export function literalsIn(name, source) {
  const found = [];
  const visit = (node) => {
    if (ts.isStringLiteralLike(node)) found.push(node.text);
    ts.forEachChild(node, visit);
  };
  visit(ts.createSourceFile(name, source, ts.ScriptTarget.ES2023, true, ts.ScriptKind.JS));
  return found;
}

/**
 * Finds the places that use texts of the tables: the written keys, and the names of their values. @param {string} name
 * @param {string} source
 */
export function callsOfTexts(name, source) {
  const file = ts.createSourceFile(name, source, ts.ScriptTarget.ES2023, true, ts.ScriptKind.JS);
  const found = [];
  const visit = (node) => {
    if (ts.isCallExpression(node) && node.expression.getText() === "t") {
      const [key, values] = node.arguments;
      const keys = keysOf(key);
      const isWhole = keys.length > 0 && (!values || (ts.isObjectLiteralExpression(values) && values.properties.every((one) => !ts.isSpreadAssignment(one))));
      const names = (values?.properties ?? []).map((one) => one.name?.text).sort();
      found.push({ keys, values: isWhole ? names : null, line: file.getLineAndCharacterOfPosition(node.getStart()).line + 1 });
    }
    ts.forEachChild(node, visit);
  };
  visit(file);
  return found;
}

/** Returns the possible keys of an argument; none if they are determined elsewhere. */
function keysOf(node) {
  if (node && ts.isStringLiteralLike(node)) return [node.text];
  if (node && ts.isConditionalExpression(node)) return [...keysOf(node.whenTrue), ...keysOf(node.whenFalse)];
  return [];
}
