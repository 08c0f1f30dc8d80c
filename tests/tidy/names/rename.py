#!/usr/bin/env python3
"""rename.py ROOT ROWS.jsonl...: applies rows of kind type/fn by rust-analyzer; logs to stdout."""
import json, subprocess, sys, threading, queue, pathlib, re, time, os
ROOT = pathlib.Path(sys.argv[1]); rows = []
for f in sys.argv[2:]:
    for l in open(f):
        if l.strip(): rows.append(json.loads(l))
p = subprocess.Popen(["rust-analyzer"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=ROOT, env=dict(os.environ))
inbox = queue.Queue(); replies = {}; ready = threading.Event(); status = {}
def read():
    while True:
        n = 0
        while True:
            line = p.stdout.readline()
            if not line: return
            line = line.strip()
            if not line: break
            if line.lower().startswith(b"content-length:"): n = int(line.split(b":")[1])
        m = json.loads(p.stdout.read(n))
        if "id" in m and "method" in m:
            res = None
            if m["method"] == "workspace/configuration": res = [SETTINGS for _ in m["params"]["items"]]
            send({"jsonrpc": "2.0", "id": m["id"], "result": res})
        elif "id" in m: replies[m["id"]] = m; inbox.put(m["id"])
        elif m["method"] == "experimental/serverStatus":
            status.update(m["params"])
            (ready.set if m["params"].get("quiescent") else ready.clear)()
lock = threading.Lock()
def send(m):
    b = json.dumps(m).encode()
    with lock:
        p.stdin.write(b"Content-Length: %d\r\n\r\n" % len(b) + b); p.stdin.flush()
ids = iter(range(1, 10**9))
def ask(method, params, timeout=300):
    i = next(ids); send({"jsonrpc": "2.0", "id": i, "method": method, "params": params}); end = time.time() + timeout
    while i not in replies:
        if time.time() > end: return {"error": {"message": "timeout"}}
        try: inbox.get(timeout=1)
        except queue.Empty: pass
    return replies.pop(i)
SETTINGS = {"cargo": {"features": "all", "allTargets": True, "buildScripts": {"enable": True}, "extraEnv": {}}, "checkOnSave": False, "procMacro": {"enable": True}, "files": {"watcher": "client", "exclude": ["target"]}, "cachePriming": {"enable": False}, "linkedProjects": [str(ROOT / "Cargo.toml"), str(ROOT / "runtime/opcua/Cargo.toml"), str(ROOT / "tests/fuzz/Cargo.toml")]}
threading.Thread(target=read, daemon=True).start()
uri = lambda f: "file://" + str(f)
r = ask("initialize", {"processId": os.getpid(), "rootUri": uri(ROOT), "capabilities": {"experimental": {"serverStatusNotification": True}, "workspace": {"didChangeWatchedFiles": {"dynamicRegistration": True}, "workspaceEdit": {"documentChanges": True, "resourceOperations": ["rename"]}, "configuration": True}, "general": {"positionEncodings": ["utf-8"]}, "textDocument": {"rename": {"prepareSupport": False}}}, "initializationOptions": SETTINGS})
print("encoding", r["result"]["capabilities"].get("positionEncoding"), flush=True)
send({"jsonrpc": "2.0", "method": "initialized", "params": {}})
t = time.time(); time.sleep(5)
while True:
    ready.wait(1200); time.sleep(4)
    if ready.is_set(): break
print("ready after", round(time.time() - t), status.get("health"), (status.get("message") or "")[:300], flush=True)
def find(row):
    f = ROOT / row["file"]; lines = f.read_text().split("\n"); best = None
    kw = r"(?:struct|enum|trait|union|type)" if row["kind"] == "type" else "fn"
    rx = re.compile(r"\b" + kw + r"\s+(" + re.escape(row["old"]) + r")\b"); impl = ""
    for n, l in enumerate(lines):
        m0 = re.match(r"\s*(?:unsafe )?(?:impl|pub trait|trait|pub\(\w+\) trait)\b(.*)", l)
        if m0: impl = m0[1]
        if l.startswith("}"): impl = ""
        m = rx.search(l)
        if m and not l.lstrip().startswith("//"):
            d = abs(n + 1 - row.get("line", 1))
            if row.get("impl") and not re.search(r"\b" + re.escape(row["impl"].split("<")[0].split("::")[-1]) + r"\b", impl): d += 200
            if best is None or d < best[0]: best = (d, n, len(l[:m.start(1)].encode()))
    return best
def apply(edit):
    per = {}
    for d in edit.get("documentChanges", []):
        if "kind" in d: print("   resource op", d, flush=True); continue
        per.setdefault(d["textDocument"]["uri"], []).extend(d["edits"])
    for u, e in (edit.get("changes") or {}).items(): per.setdefault(u, []).extend(e)
    changed = []
    for u, edits in per.items():
        f = pathlib.Path(u[7:]); data = f.read_bytes(); starts = [0]
        for i, b in enumerate(data):
            if b == 10: starts.append(i + 1)
        pos = lambda q: starts[q["line"]] + q["character"]
        seen = set()
        for e in sorted(edits, key=lambda e: (e["range"]["start"]["line"], e["range"]["start"]["character"]), reverse=True):
            k = (pos(e["range"]["start"]), pos(e["range"]["end"]))
            if k in seen: continue
            seen.add(k); data = data[:k[0]] + e["newText"].encode() + data[k[1]:]
        f.write_bytes(data); changed.append(u)
    send({"jsonrpc": "2.0", "method": "workspace/didChangeWatchedFiles", "params": {"changes": [{"uri": u, "type": 2} for u in changed]}})
    return per
done = 0
rows = [r for r in rows if not r.get("keep") and r.get("kind") in ("type", "fn") and r["file"].endswith(".rs") and not str(r.get("note", "")).startswith("via-trait") and not r.get("via-trait") and r.get("new")]
rows.sort(key=lambda r: r["kind"] != "fn")
for i, row in enumerate(rows):
    t = time.time()
    try: at = find(row)
    except FileNotFoundError: at = None
    if at is None: print("MISSING", json.dumps(row), flush=True); continue
    if at[0] > 150: print("FAR", at, json.dumps(row), flush=True)
    for attempt in range(4):
        r = ask("textDocument/rename", {"textDocument": {"uri": uri(ROOT / row["file"])}, "position": {"line": at[1], "character": at[2]}, "newName": row["new"]})
        msg = (r.get("error") or {}).get("message", "")
        if "content modified" in msg or "cancel" in msg.lower(): time.sleep(0.5); continue
        break
    if r.get("result"):
        per = apply(r["result"]); done += 1
        print(f"ok {i+1}/{len(rows)} {row['old']} -> {row['new']} {sum(map(len, per.values()))} in {len(per)} files {time.time()-t:.1f}s", flush=True)
    else: print("FAILED", msg[:200], json.dumps(row), flush=True)
print("done", done, "of", len(rows)); ask("shutdown", None, 10); p.kill()
