//! The layers: a folder of `src/` imports lower folders only, and no file takes part in a circle of imports.
//!
//! The order is read from the table "Layers" of ARCHITECTURE.md, so that text and code cannot disagree.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Path of a module below the crate, for example `["shell", "live", "capture"]`.
type Module = Vec<String>;

/// All source files below `folder`, by module.
fn modules(folder: &Path) -> BTreeMap<Module, PathBuf> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let inside = path.strip_prefix(folder).unwrap().with_extension("");
                let mut module: Module =
                    inside.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
                if module.last().is_some_and(|last| last == "mod") {
                    module.pop();
                }
                found.insert(module, path);
            }
        }
    }
    found
}

/// The folder that the order speaks of: `shell/live` inside the shell, the first folder elsewhere.
fn layer(module: &[String]) -> String {
    let depth = if module[0] == "shell" { 2 } else { 1 };
    module[..depth.min(module.len())].join("/")
}

/// Layers from the lowest up: first column of the table below the heading "Layers".
fn order(architecture: &str) -> Vec<String> {
    let (_, text) = architecture.split_once("## Layers").expect("a heading `## Layers`");
    let text = text.split("\n## ").next().unwrap_or_default();
    let cells = text.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next());
    cells.map(str::to_owned).collect()
}

/// Code without comments and without unit tests: `#[cfg(test)] mod ... { ... }` at the left margin.
fn code(text: &str) -> String {
    let lines: Vec<&str> = text.lines().map(|l| l.split("//").next().unwrap_or_default()).collect();
    let mut kept = String::new();
    let mut skip = false;
    for (at, line) in lines.iter().enumerate() {
        let test = at > 0 && lines[at - 1].trim() == "#[cfg(test)]" && line.ends_with('{');
        skip |= test && !line.starts_with(' ');
        if !skip {
            kept.push_str(line);
            kept.push('\n');
        }
        skip &= *line != "}";
    }
    kept
}

/// Splits a list at its outermost commas.
fn parts(list: &str) -> Vec<&str> {
    let (mut depth, mut start, mut found) = (0, 0, Vec::new());
    for (at, c) in list.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => {
                found.push(&list[start..at]);
                return found;
            }
            '}' => depth -= 1,
            ',' if depth == 0 => {
                found.push(&list[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    found.push(&list[start..]);
    found
}

/// Paths that begin at `text`: a plain one, or those of a list in braces.
fn paths(text: &str, before: &[String], found: &mut Vec<Module>) {
    let mut path = before.to_vec();
    let mut rest = text.trim_start();
    loop {
        if let Some(list) = rest.strip_prefix('{') {
            for part in parts(list) {
                paths(part, &path, found);
            }
            return;
        }
        let length = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        if length == 0 {
            break;
        }
        path.push(rest[..length].to_owned());
        let Some(next) = rest[length..].strip_prefix("::") else { break };
        rest = next;
    }
    found.push(path);
}

/// Whether a word begins at byte `at`.
fn begins_word(text: &str, at: usize) -> bool {
    // `pub(in crate::shell)` says who may see an item; it imports nothing.
    let before = &text[..at];
    !before.ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':')
        && !before.ends_with("(in ")
}

/// Absolute paths that a file of `module` names by `crate::`, `super::` and `self::`.
fn named(text: &str, module: &[String]) -> Vec<Module> {
    // A visibility is no import.
    let text = code(text).replace("pub(in crate::", "pub(");
    let mut found = Vec::new();
    for head in ["crate::", "self::", "super::"] {
        for (at, _) in text.match_indices(head).filter(|(at, _)| begins_word(&text, *at)) {
            let mut rest = &text[at..];
            let mut base = module.to_vec();
            rest = rest.strip_prefix("self::").unwrap_or(rest);
            while let Some(next) = rest.strip_prefix("super::") {
                base.pop();
                rest = next;
            }
            if let Some(next) = rest.strip_prefix("crate::") {
                base.clear();
                rest = next;
            }
            paths(rest, &base, &mut found);
        }
    }
    found
}

/// For each module the modules that it imports; a parent that declares and uses its children is no import of them.
fn imports(folder: &Path) -> BTreeMap<Module, BTreeSet<Module>> {
    let files = modules(folder);
    let mut all = BTreeMap::new();
    for (module, file) in &files {
        let top = module.len() == 1 && (module[0] == "lib" || module[0] == "main");
        if top || module.iter().any(|part| part == "tests") {
            continue;
        }
        let mut used = BTreeSet::new();
        for path in named(&fs::read_to_string(file).unwrap(), module) {
            let other = (1..=path.len()).rev().map(|k| &path[..k]).find(|p| files.contains_key(*p));
            if let Some(other) = other.filter(|other| *other != &module[..]) {
                used.insert(other.to_vec());
            }
        }
        all.insert(module.clone(), used);
    }
    all
}

/// Imports of a layer that is not lower, and layers that the order does not name.
fn upward(imports: &BTreeMap<Module, BTreeSet<Module>>, order: &[String]) -> Vec<String> {
    let place = |layer: &str| order.iter().position(|name| name == layer);
    let mut wrong = Vec::new();
    for (module, used) in imports {
        let own = layer(module);
        if own == "shell" {
            continue;
        }
        let Some(here) = place(&own) else {
            wrong.push(format!("{own} stands in no line of the table Layers"));
            continue;
        };
        for other in used.iter().map(|other| layer(other)).filter(|other| *other != own) {
            if place(&other).is_none_or(|there| there >= here) {
                wrong.push(format!("{} (layer {own}) imports {other}", module.join("/")));
            }
        }
    }
    wrong.dedup();
    wrong
}

/// Files on a circle of imports. A folder's `mod.rs` and the files in it count as one where the file imports its parent.
fn circles(imports: &BTreeMap<Module, BTreeSet<Module>>) -> Vec<String> {
    let mut left: BTreeMap<&Module, BTreeSet<&Module>> = BTreeMap::new();
    for (module, used) in imports {
        // An ancestor's items are shared by its children, like a header; what it declares is no import.
        let below = used.iter().filter(|other| !module.starts_with(other));
        left.insert(module, below.collect());
    }
    loop {
        let leaves: Vec<&Module> = left
            .iter()
            .filter(|(_, used)| used.iter().all(|other| !left.contains_key(*other)))
            .map(|(module, _)| *module)
            .collect();
        if leaves.is_empty() {
            return left.keys().map(|module| module.join("/")).collect();
        }
        for module in leaves {
            left.remove(module);
        }
    }
}

fn architecture_order() -> Vec<String> {
    order(&fs::read_to_string(Path::new(ROOT).join("ARCHITECTURE.md")).unwrap())
}

#[test]
fn folders_import_lower_folders_only() {
    let imports = imports(&Path::new(ROOT).join("src"));
    assert!(imports.len() > 100, "too few files found: {}", imports.len());
    let wrong = upward(&imports, &architecture_order());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_dependency_has_its_reason() {
    let read = |name: &str| fs::read_to_string(Path::new(ROOT).join(name)).unwrap();
    let manifest = read("Cargo.toml");
    let mut inside = false;
    let mut wanted = BTreeSet::new();
    for line in manifest.lines() {
        if line.starts_with('[') {
            inside = line.trim_end_matches(']').ends_with("dependencies");
        } else if let Some((name, _)) = line.split_once(" = ").filter(|_| inside) {
            wanted.insert(name);
        }
    }
    assert!(wanted.len() > 30, "{wanted:?}");
    let architecture = read("ARCHITECTURE.md");
    let (_, text) = architecture.split_once("## Dependencies").unwrap();
    let text = text.split("\n## ").next().unwrap();
    let cells = text.lines().filter_map(|line| line.strip_prefix("| `")?.split('|').next());
    let listed: BTreeSet<&str> =
        cells.flat_map(|cell| cell.split(", ")).map(|n| n.trim().trim_matches('`')).collect();
    assert_eq!(listed, wanted);
}

#[test]
fn no_file_is_on_a_circle() {
    let found = circles(&imports(&Path::new(ROOT).join("src")));
    assert!(found.is_empty(), "on circles or above them: {}", found.join(", "));
}

/// A crate of two layers and a shell, written to a folder and changed by one line.
fn mutated(file: &str, line: &str) -> (Vec<String>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path();
    let write = |name: &str, text: &str| {
        let path = source.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let old = fs::read_to_string(&path).unwrap_or_default();
        fs::write(path, old + text).unwrap();
    };
    write("low/mod.rs", "pub mod part;\n");
    write("low/part.rs", "use super::Item;\n");
    write("high.rs", "use crate::low::{self, part};\n");
    write("shell/mod.rs", "");
    write("shell/a.rs", "use crate::high;\n");
    write("shell/b/mod.rs", "use super::a;\n");
    write("shell/b/one.rs", "");
    write("shell/b/two.rs", "use super::one;\n");
    write(file, line);
    let order = ["low", "high", "shell/a", "shell/b"].map(str::to_owned);
    let imports = imports(source);
    (upward(&imports, &order), circles(&imports))
}

#[test]
fn upward_imports_of_each_kind_are_found() {
    assert_eq!(mutated("high.rs", "// use crate::shell::a;\n"), (vec![], vec![]));
    for (file, line) in [
        ("low/part.rs", "use crate::high;\n"),
        ("low/mod.rs", "use super::high;\n"),
        ("low/part.rs", "use super::super::high::X;\n"),
        ("low/mod.rs", "fn f() { crate::high::g() }\n"),
        ("high.rs", "use crate::{low, shell::{a, b}};\n"),
        ("shell/a.rs", "use super::b;\n"),
        ("shell/a.rs", "use crate::shell::b::one;\n"),
        ("shell/a.rs", "use self::super::b;\n"),
        ("shell/c.rs", "use crate::low;\n"),
    ] {
        let (wrong, _) = mutated(file, line);
        assert!(!wrong.is_empty(), "{line} in {file} was not seen");
    }
    let (_, circles) = mutated("shell/b/one.rs", "use super::two;\n");
    assert_eq!(circles, ["shell/b/one", "shell/b/two"]);
}
