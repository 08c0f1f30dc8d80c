// The types of what is vendored are those of its packages.
export * from "../../tests/browser/codemirror.mjs";
