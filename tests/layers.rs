//! Every module states its level, and uses modules of lower levels only.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

const SOURCE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/src");

/// Above all modules.
const TOP: [&str; 2] = ["lib", "main"];

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// The top-level module that a file belongs to.
fn module(file: &Path) -> String {
    let inside = file.strip_prefix(SOURCE).unwrap();
    let first = inside.components().next().unwrap().as_os_str();
    Path::new(first).file_stem().unwrap().to_str().unwrap().to_owned()
}

/// N of "(level N)" in the module's own documentation.
fn level(text: &str) -> Option<u32> {
    let header = text.lines().map_while(|line| line.strip_prefix("//!"));
    let header: String = header.collect();
    let words = header.split_once("(level")?.1;
    words.split_once(')')?.0.trim().parse().ok()
}

/// The modules of this crate that a source file names, comments aside: `crate::a` and `crate::{a, b::c}`.
fn used(text: &str) -> Vec<String> {
    let code: Vec<&str> =
        text.lines().map(|line| line.split("//").next().unwrap_or_default()).collect();
    let code = code.join("\n");
    let mut modules = Vec::new();
    for path in code.split("crate::").skip(1) {
        let Some(list) = path.strip_prefix('{') else {
            modules.push(identifier(path));
            continue;
        };
        let mut depth = 0;
        let mut start = true;
        for (at, c) in list.char_indices() {
            match c {
                '}' if depth == 0 => break,
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 0 => start = true,
                c if start && !c.is_whitespace() => {
                    modules.push(identifier(&list[at..]));
                    start = false;
                }
                _ => {}
            }
        }
    }
    modules
}

fn identifier(text: &str) -> String {
    text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

#[test]
fn paths_are_found() {
    let text =
        "use crate::{a::{x, y}, b,\n    c as d};\n// crate::no\nlet x = crate::e::f(crate::g);";
    assert_eq!(used(text), ["a", "b", "c", "e", "g"]);
    assert_eq!(level("//! Words\n//! (level 3).\n\nuse x;"), Some(3));
    assert_eq!(level("//! Words.\n// (level 3)"), None);
}

#[test]
fn modules_use_lower_levels_only() {
    let mut all = Vec::new();
    files(Path::new(SOURCE), &mut all);
    let texts: Vec<(String, PathBuf, String)> = all
        .into_iter()
        .map(|file| (module(&file), file.clone(), fs::read_to_string(&file).unwrap()))
        .filter(|(module, ..)| !TOP.contains(&module.as_str()))
        .collect();
    let mut levels = BTreeMap::new();
    for (module, file, text) in &texts {
        // A module in a folder states its level in the folder's mod.rs.
        let names_module =
            file.parent() == Some(Path::new(SOURCE)) || file.ends_with(format!("{module}/mod.rs"));
        if names_module {
            let level = level(text);
            let level = level.unwrap_or_else(|| panic!("{} states no (level N)", file.display()));
            levels.insert(module.as_str(), level);
        }
    }
    assert!(levels.len() > 5, "too few modules found: {levels:?}");
    let mut wrong = Vec::new();
    for (module, file, text) in &texts {
        for name in used(text) {
            let Some(&other) = levels.get(name.as_str()) else {
                panic!("{}: crate::{name} is no module", file.display());
            };
            let own = levels[module.as_str()];
            let allowed = name == *module || other < own;
            if !allowed {
                let file = file.file_name().unwrap().display();
                wrong.push(format!("{file} (level {own}) uses {name} (level {other})"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
