#!/usr/bin/env python3
"""Lists the public API of both crates beside this file, so that a change of it shows in a diff; with --check, tells whether the
lists are as they should be.

    tests/api/run.py [--check]

It reads what rustdoc writes as JSON, of which the form is not settled: RUSTC_BOOTSTRAP lets the stable compiler write it. One
line an item: its path, its signature, and of types the traits that are implemented by hand or derived.
"""

import difflib
import json
import os
import pathlib
import subprocess
import sys

HERE = pathlib.Path(__file__).parent
ROOT = HERE.parent.parent
# With the features that are on by default: those that `./test` checks, whose dependencies are there.
CRATES = ("planecast", "planecast-encoder")


def path_of(of):
    """A path with its arguments."""
    return (of.get("path") or of.get("name", "")) + arguments(of.get("args"))


def arguments(args):
    if not args:
        return ""
    if "parenthesized" in args:
        of = args["parenthesized"]
        return f"({', '.join(map(type_of, of['inputs']))})" + (f" -> {type_of(of['output'])}" if of["output"] else "")
    of = args.get("angle_bracketed")
    if not of:
        return ""
    parts = []
    for arg in of["args"]:
        kind, value = next(iter(arg.items())) if isinstance(arg, dict) else (arg, None)
        parts.append({"lifetime": lambda: value, "type": lambda: type_of(value), "const": lambda: value["expr"]}.get(kind, lambda: "_")())
    for bound in of.get("constraints", []):
        binding = bound["binding"]
        if "equality" in binding:
            parts.append(f"{bound['name']} = {type_of(binding['equality'].get('type'))}")
        else:
            parts.append(f"{bound['name']}: {bounds(binding['constraint'])}")
    return f"<{', '.join(parts)}>" if parts else ""


def bounds(of):
    parts = []
    for bound in of:
        if "trait_bound" in bound:
            trait = bound["trait_bound"]
            mark = {"maybe": "?", "none": ""}.get(trait["modifier"], "")
            parts.append(mark + path_of(trait["trait"]))
        elif "outlives" in bound:
            parts.append(bound["outlives"])
        else:
            parts.append("use<…>")
    return " + ".join(parts)


def type_of(of):
    if of is None:
        return "()"
    if isinstance(of, str):
        return "_"
    kind, value = next(iter(of.items()))
    if kind == "resolved_path":
        return path_of(value)
    if kind in ("generic", "primitive"):
        return value
    if kind == "dyn_trait":
        traits = [path_of(t["trait"]) for t in value["traits"]] + ([value["lifetime"]] if value["lifetime"] else [])
        return "dyn " + " + ".join(traits)
    if kind == "borrowed_ref":
        lifetime = f"{value['lifetime']} " if value["lifetime"] else ""
        return f"&{lifetime}{'mut ' if value['is_mutable'] else ''}{type_of(value['type'])}"
    if kind == "raw_pointer":
        return f"*{'mut' if value['is_mutable'] else 'const'} {type_of(value['type'])}"
    if kind == "tuple":
        return f"({', '.join(map(type_of, value))}{',' if len(value) == 1 else ''})"
    if kind == "slice":
        return f"[{type_of(value)}]"
    if kind == "array":
        return f"[{type_of(value['type'])}; {value['len']}]"
    if kind == "impl_trait":
        return f"impl {bounds(value)}"
    if kind == "qualified_path":
        trait = value.get("trait")
        return f"<{type_of(value['self_type'])}{' as ' + path_of(trait) if trait else ''}>::{value['name']}"
    if kind == "function_pointer":
        return f"fn{signature(value['sig'])}"
    return kind


def signature(sig):
    inputs = ", ".join(type_of(t) if name != "self" else receiver(t) for name, t in sig["inputs"])
    return f"({inputs})" + (f" -> {type_of(sig['output'])}" if sig["output"] else "")


def receiver(of):
    return type_of(of).replace("Self", "self") if isinstance(of, dict) else "self"


def generics(of):
    parts = []
    for param in of["params"]:
        kind, value = next(iter(param["kind"].items()))
        if kind == "type" and not value.get("is_synthetic"):
            parts.append(param["name"] + (f": {bounds(value['bounds'])}" if value["bounds"] else ""))
        elif kind == "const":
            parts.append(f"const {param['name']}: {type_of(value['type'])}")
    return f"<{', '.join(parts)}>" if parts else ""


class Listing:
    def __init__(self, crate):
        self.index, self.paths = crate["index"], crate["paths"]
        self.lines, self.seen = set(), set()
        root = self.index[str(crate["root"])]
        self.module(root, root["name"])

    def item(self, id):
        return self.index.get(str(id))

    def add(self, *words):
        self.lines.add(" ".join(filter(None, words)))

    def module(self, of, path):
        if (of["id"], path) in self.seen:
            return
        self.seen.add((of["id"], path))
        for child in of["inner"]["module"]["items"]:
            if item := self.item(child):
                self.one(item, path)

    def one(self, item, path):
        kind, of = next(iter(item["inner"].items()))
        if kind == "use":
            target = self.item(of["id"]) if of["id"] is not None else None
            if target is None:
                return self.add("use", f"{path}::{of['name']} = {of['source']}")
            if of["is_glob"]:
                return self.module(target, path) if "module" in target["inner"] else None
            return self.one({**target, "name": of["name"]}, path)
        name = f"{path}::{item['name']}"
        if kind == "module":
            self.add("mod", name)
            self.module(item, name)
        elif kind == "function":
            words = " ".join(w for w in ("const", "async", "unsafe") if of["header"][f"is_{w}"])
            self.add(words, "fn", name + generics(of["generics"]) + signature(of["sig"]))
        elif kind in ("struct", "enum", "union"):
            self.add(kind, name + generics(of["generics"]))
            self.fields(of, kind, name)
            self.impls(of["impls"], name)
        elif kind == "trait":
            self.add("trait", name + generics(of["generics"]) + (f": {bounds(of['bounds'])}" if of["bounds"] else ""))
            for child in filter(None, map(self.item, of["items"])):
                self.one(child, name)
        elif kind == "constant":
            self.add("const", f"{name}: {type_of(of['type'])}")
        elif kind == "static":
            self.add("static", f"{name}: {type_of(of['type'])}")
        elif kind == "type_alias":
            self.add("type", f"{name}{generics(of['generics'])} = {type_of(of['type'])}")
        elif kind == "assoc_const":
            self.add("const", f"{name}: {type_of(of['type'])}")
        elif kind == "assoc_type":
            self.add("type", name)
        elif kind in ("macro", "proc_macro"):
            self.add("macro", name)

    def fields(self, of, kind, name):
        if kind == "enum":
            for variant in filter(None, map(self.item, of["variants"])):
                self.add("variant", f"{name}::{variant['name']}")
                shape = variant["inner"]["variant"]["kind"]
                if isinstance(shape, dict):
                    self.shape(shape, f"{name}::{variant['name']}")
        elif kind == "struct" and isinstance(of["kind"], dict):
            self.shape(of["kind"], name)

    def shape(self, shape, name):
        named = shape.get("plain") or shape.get("struct")
        ids = named["fields"] if named else shape.get("tuple", [])
        for field in (self.item(i) for i in ids if i is not None):
            if field:
                self.add("field", f"{name}.{field['name']}: {type_of(field['inner']['struct_field'])}")

    def impls(self, ids, name):
        for impl in filter(None, map(self.item, ids)):
            of = impl["inner"]["impl"]
            if of["is_synthetic"] or of["blanket_impl"]:
                continue
            if of["trait"]:
                self.add("impl", f"{path_of(of['trait'])} for {name}")
                continue
            for child in filter(None, map(self.item, of["items"])):
                if child["visibility"] == "public":
                    self.one(child, name)


def listing(crate):
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    command = ["cargo", "rustdoc", "-p", crate, "--lib", "--", "-Zunstable-options", "--output-format", "json"]
    subprocess.run(command, cwd=ROOT, check=True, env={**os.environ, "RUSTC_BOOTSTRAP": "1", "RUSTDOCFLAGS": ""})
    read = json.loads((target / "doc" / f"{crate.replace('-', '_')}.json").read_text())
    return "".join(f"{line}\n" for line in sorted(Listing(read).lines, key=lambda l: (l.split(" ", 1)[-1], l)))


def main():
    changed = False
    for crate in CRATES:
        file, now = HERE / f"{crate}.txt", listing(crate)
        if "--check" in sys.argv:
            was = file.read_text() if file.exists() else ""
            for line in difflib.unified_diff(was.splitlines(), now.splitlines(), file.name, "now", lineterm="", n=0):
                print(line)
            changed |= was != now
        else:
            file.write_text(now)
    if changed:
        sys.exit("the public API is another one: tests/api/run.py writes the lists anew; say in CHANGELOG.md what changed for who uses it")


if __name__ == "__main__":
    main()
