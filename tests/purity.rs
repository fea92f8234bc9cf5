//! The floors of the house: imports go downward only, and the pure wing does no I/O, waits for nothing and
//! keeps no global state.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// From the ground up. A module is on the floor with the longest name that it begins with.
const FLOORS: [&str; 77] = [
    "analysis::numerics",
    "analysis::rod::beam",
    "analysis::rod::fixity",
    "analysis::rod::prior",
    "analysis::rod::query",
    "analysis::rod::emulator",
    "analysis::signal::record",
    "analysis::signal::spectrum",
    "analysis::signal::modes",
    "analysis::signal::array",
    "analysis::inference",
    "analysis::identify",
    "analysis::findings",
    "analysis::track::observation",
    "analysis::track::settings",
    "analysis::track::ordered",
    "analysis::track::baseline",
    "analysis::track::relative",
    "analysis::track::alternatives",
    "analysis::track::drift",
    "analysis::track::thermometer",
    "analysis::track::plausibility",
    "analysis::track::alarm",
    "analysis::track::fold",
    "analysis::outcome",
    "analysis::record_view",
    "analysis::builder",
    "analysis::lab::ann",
    "analysis::lab::likelihood",
    "analysis::lab::chains",
    "analysis::lab::mcmc",
    "analysis::lab::synthesis",
    "analysis::lab::study",
    "recording::atomic",
    "recording::part",
    "recording::note",
    "recording::write",
    "recording::read",
    "recording::import",
    "config::settings",
    "config",
    "site::clock",
    "site::hex",
    "site::text",
    "site::ordered_map",
    "site::emulator_cache",
    "site::prepared",
    "site::record_row",
    "site::found",
    "site::store",
    "site::baselines",
    "site::pictures",
    "site::analyse",
    "site::records",
    "site::motion",
    "site::overlap",
    "site::resumption",
    "site::trackers",
    "site::driver",
    "site::reanalysis",
    "site::fleet",
    "service::memory",
    "service::tcp",
    "service::tls",
    "service::telemetry",
    "service::journal",
    "service::ingest",
    "service::api",
    "service::viewer",
    "service::http",
    "service::alert",
    "service::forward",
    "service::bucket",
    "service::hub",
    "service::daemon",
    "command::report_page",
    "command",
];

/// Modules that only declare the floors below them, and name for outside what those hold.
const STAIRS: [&str; 9] = [
    "",
    "analysis",
    "analysis::rod",
    "analysis::signal",
    "analysis::track",
    "analysis::lab",
    "recording",
    "site",
    "service",
];

/// Paths and macros of I/O, waiting, global state or the machine.
const FORBIDDEN: [&str; 21] = [
    "std::env",
    "std::fs",
    "std::io",
    "std::net",
    "std::process",
    "std::thread",
    "std::time::Instant",
    "std::time::SystemTime",
    "tokio",
    "tracing",
    "rusqlite",
    "jiff::Timestamp::now",
    "jiff::Zoned::now",
    "rand::rng",
    "rand::thread_rng",
    "rand::rngs::SysRng",
    "print!",
    "println!",
    "eprint!",
    "eprintln!",
    "dbg!",
];

/// A word, a sign or `::`, with its line.
type Token<'t> = (usize, &'t str);

/// Tokens of Rust source without comments, strings and characters.
fn tokens(text: &str) -> Vec<Token<'_>> {
    let mut found = Vec::new();
    let (mut rest, mut line) = (text, 1);
    while let Some(first) = rest.chars().next() {
        let length = match first {
            '/' if rest.starts_with("//") => rest.find('\n').unwrap_or(rest.len()),
            '/' if rest.starts_with("/*") => rest.find("*/").map_or(rest.len(), |end| end + 2),
            '"' => quoted(rest),
            'r' if rest
                .trim_start_matches('r')
                .trim_start_matches('#')
                .starts_with('"')
                && rest[1..].starts_with(['#', '"']) =>
            {
                let hashes = rest[1..].len() - rest[1..].trim_start_matches('#').len();
                let end = format!("\"{}", "#".repeat(hashes));
                let from = hashes + 2;
                rest[from..]
                    .find(&end)
                    .map_or(rest.len(), |at| from + at + end.len())
            }
            '\'' => character(rest),
            _ if first.is_alphanumeric() || first == '_' => {
                let is_word = |c: char| c.is_alphanumeric() || c == '_';
                let length = rest.find(|c| !is_word(c)).unwrap_or(rest.len());
                found.push((line, &rest[..length]));
                length
            }
            ':' if rest.starts_with("::") => {
                found.push((line, "::"));
                2
            }
            _ if first.is_whitespace() => first.len_utf8(),
            _ => {
                found.push((line, &rest[..first.len_utf8()]));
                first.len_utf8()
            }
        };
        line += rest[..length].matches('\n').count();
        rest = &rest[length..];
    }
    found
}

/// Length of the string literal in front.
fn quoted(text: &str) -> usize {
    let mut escaped = false;
    for (at, c) in text.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => return at + 1,
            _ => {}
        }
    }
    text.len()
}

/// Length of the character literal in front; 1 for the quote of a lifetime.
fn character(text: &str) -> usize {
    let mut chars = text.char_indices().skip(1);
    match chars.next() {
        Some((_, '\\')) => text[3..].find('\'').map_or(text.len(), |at| at + 4),
        Some(_) => match chars.next() {
            Some((at, '\'')) => at + 1,
            _ => 1,
        },
        None => 1,
    }
}

/// A path with its line: absolute within the crate (`crate` in front) or as written.
type Mention = (usize, Vec<String>);

/// All paths of a module's source, groups of `use` taken apart, `super` and `self` resolved.
fn paths(module: &[String], text: &str) -> Vec<Mention> {
    let tokens = tokens(text);
    let word = |at: usize| tokens.get(at).map_or("", |token| token.1);
    let mut inline: Vec<(usize, String)> = Vec::new();
    let (mut depth, mut at, mut found) = (0, 0, Vec::new());
    while at < tokens.len() {
        match word(at) {
            "{" => depth += 1,
            "}" => {
                depth -= 1;
                inline.pop_if(|(outside, _)| *outside == depth);
            }
            "mod" if word(at + 2) == "{" => inline.push((depth, word(at + 1).to_owned())),
            _ => {}
        }
        let starts = word(at + 1) == "::" || word(at + 1) == "!" || word(at) == "use" && word(at + 1) == "{";
        if starts && word(at).starts_with(|c: char| c.is_alphabetic()) && (at == 0 || word(at - 1) != "::") {
            let from = if word(at) == "use" { at + 1 } else { at };
            let mut leaves = Vec::new();
            let end = expand(&tokens, from, Vec::new(), &mut leaves);
            let here: Vec<&str> = module
                .iter()
                .map(String::as_str)
                .chain(inline.iter().map(|(_, name)| name.as_str()))
                .collect();
            found.extend(
                leaves
                    .into_iter()
                    .map(|(line, path)| (line, absolute(&here, &path))),
            );
            at = end.max(at + 1);
        } else {
            at += 1;
        }
    }
    found
}

/// Leaves of the path or tree of paths at `at`; returns the place after it.
fn expand<'t>(
    tokens: &[Token<'t>],
    mut at: usize,
    mut path: Vec<&'t str>,
    leaves: &mut Vec<(usize, Vec<&'t str>)>,
) -> usize {
    let word = |at: usize| tokens.get(at).map_or("", |token| token.1);
    if word(at) == "{" {
        at += 1;
        while at < tokens.len() && word(at) != "}" {
            at = expand(tokens, at, path.clone(), leaves);
            while at < tokens.len() && word(at) != "," && word(at) != "}" {
                at += 1; // as another name
            }
            at += usize::from(word(at) == ",");
        }
        return at + 1;
    }
    let line = tokens.get(at).map_or(0, |token| token.0);
    path.push(word(at));
    if word(at + 1) == "!" {
        path.push("!");
    } else if word(at + 1) == "::" {
        let next = word(at + 2);
        if next == "{" || next == "*" || next.starts_with(|c: char| c.is_alphabetic() || c == '_') {
            return expand(tokens, at + 2, path, leaves);
        }
    }
    leaves.push((line, path));
    at + 1
}

/// Wings that are crates of their own: the `crate` of their files is `crate::analysis`, `crate::recording`.
const CRATES: [&str; 2] = ["analysis", "recording"];

/// A path seen from a module: `super`, `self`, `crate` and names of crates taken out, `crate` in front of what lies below `src`.
fn absolute(here: &[&str], path: &[&str]) -> Vec<String> {
    let mut at: Vec<&str> = vec!["crate"];
    let mut rest = path;
    match path[0] {
        "crate" => {
            at.extend(here.first().filter(|wing| CRATES.contains(wing)));
            rest = &path[1..];
        }
        "super" | "self" => {
            at.extend(here);
            while let Some((first, tail)) = rest.split_first()
                && (*first == "super" || *first == "self")
            {
                if *first == "super" {
                    at.pop();
                }
                rest = tail;
            }
        }
        name => match CRATES
            .iter()
            .find(|wing| name.strip_prefix("tirante_") == Some(**wing))
        {
            Some(wing) => {
                at.push(wing);
                rest = &path[1..];
            }
            None => at.clear(),
        },
    }
    at.iter()
        .chain(rest)
        .filter(|word| **word != "self")
        .map(|word| (*word).to_owned())
        .collect()
}

/// True if a path begins with a module's name.
fn begins(path: &[String], module: &str) -> bool {
    let mut names = path.iter();
    module.is_empty()
        || module
            .split("::")
            .all(|name| names.next().is_some_and(|first| first == name))
}

/// The longest of some modules that a path begins with.
fn longest(modules: &'static [&'static str], path: &[String]) -> Option<usize> {
    let found = modules
        .iter()
        .enumerate()
        .filter(|(_, module)| begins(path, module));
    found
        .max_by_key(|(_, module)| module.len())
        .map(|(index, _)| index)
}

/// The upward imports of one file. A name that stairs lend is as high as the highest floor they lead to; the floors they lead to
/// may not borrow it.
fn upward(module: &[String], text: &str) -> Vec<String> {
    let name = module.join("::");
    let Some(own) = longest(&FLOORS, module) else {
        let is_known = STAIRS.contains(&name.as_str());
        return if is_known {
            Vec::new()
        } else {
            vec![format!("{name} is on no floor")]
        };
    };
    let mut offences = Vec::new();
    for (line, path) in paths(module, text) {
        let Some(("crate", rest)) = path.split_first().map(|(first, rest)| (first.as_str(), rest)) else {
            continue;
        };
        let other = longest(&FLOORS, rest).or_else(|| {
            let stairs = STAIRS[longest(&STAIRS, rest)?];
            let is_outside = !begins(module, stairs);
            let reached = FLOORS.iter().rposition(|floor| floor.starts_with(stairs));
            reached.filter(|_| is_outside)
        });
        if other.is_none_or(|other| other > own) {
            let floor = other.map_or("no floor", |other| FLOORS[other]);
            offences.push(format!("{name}:{line}: {} is on {floor}", path.join("::")));
        }
    }
    offences
}

/// Forbidden paths and macros in one file's shipped part: everything before its test module.
fn impure(module: &[String], text: &str) -> Vec<String> {
    let shipped = text.find("\n#[cfg(test)]\nmod ").map_or(text, |end| &text[..end]);
    let mut offences = Vec::new();
    for (line, path) in paths(module, shipped) {
        let said = path.join("::").replace("::!", "!");
        let is = |word: &&&str| {
            said == **word
                || said
                    .strip_prefix(**word)
                    .is_some_and(|rest| rest.starts_with("::"))
        };
        if let Some(word) = FORBIDDEN.iter().find(is) {
            offences.push(format!("{}:{line}: {word}", module.join("::")));
        }
    }
    offences
}

/// Modules below `src` with their text.
fn modules() -> BTreeMap<Vec<String>, String> {
    fn gather(path: &Path, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(path).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                gather(&path, found);
            } else if path.extension().is_some_and(|e| e == "rs") {
                found.push(path);
            }
        }
    }
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    gather(&source, &mut files);
    let module = |file: &Path| -> Vec<String> {
        let path = file.strip_prefix(&source).unwrap().with_extension("");
        let mut names: Vec<String> = path
            .iter()
            .map(|name| name.to_string_lossy().into_owned())
            .collect();
        names.pop_if(|name| name == "mod" || name == "lib");
        names
    };
    let program = source.join("main.rs");
    files
        .iter()
        .filter(|file| **file != program)
        .map(|file| (module(file), fs::read_to_string(file).unwrap()))
        .collect()
}

#[test]
fn imports_go_downward() {
    let modules = modules();
    assert!(modules.len() > 300, "only {} modules found", modules.len());
    let inhabited: BTreeSet<usize> = modules
        .keys()
        .filter_map(|module| longest(&FLOORS, module))
        .collect();
    assert_eq!(inhabited.len(), FLOORS.len(), "a floor without modules");
    let offences: Vec<String> = modules
        .iter()
        .flat_map(|(module, text)| upward(module, text))
        .collect();
    assert!(
        offences.is_empty(),
        "{} imports go to a higher floor:\n{}",
        offences.len(),
        offences.join("\n")
    );
}

#[test]
fn the_pure_wing_knows_no_file_clock_generator_or_thread() {
    let modules = modules();
    let pure = modules
        .iter()
        .filter(|(module, _)| module.first().is_some_and(|wing| wing == "analysis"));
    let offences: Vec<String> = pure.flat_map(|(module, text)| impure(module, text)).collect();
    assert!(
        offences.is_empty(),
        "pure code reaches outside:\n{}",
        offences.join("\n")
    );
}

#[test]
fn every_way_to_write_an_upward_import_is_seen() {
    let pure = ["analysis", "rod", "prior"].map(str::to_owned);
    let recording = ["recording", "read", "json"].map(str::to_owned);
    let shell = ["config", "settings", "http"].map(str::to_owned);
    for (module, text) in [
        (&shell, "use crate::site::store::Store;"),
        (&shell, "use super::super::super::site::store::Store;"),
        (
            &shell,
            "use crate::{analysis::numerics::random, site::store::{Store as S, }};",
        ),
        (&pure, "pub(crate) use crate::{signal::record::RodId as Id};"),
        (&shell, "fn f(x: &crate::config::Config) {}"),
        (&pure, "mod tests { use super::super::super::signal::modes; }"),
        (&pure, "use super::super::inference;"),
        (&pure, "use crate::track::State;"),
        (&pure, "use crate::track;"),
        (&pure, "use super::Prior;"),
        (&pure, "use tirante_recording::part;"),
        (&recording, "use crate::import::How;"),
        (&recording, "use super::super::import::How;"),
        (
            &shell,
            "let text = \"// \\\" {\"; // {\nlet c = '\"'; crate::service::http::now();",
        ),
    ] {
        assert_eq!(upward(module, text).len(), 1, "{text}");
    }
    for (module, text) in [
        (&pure, "use crate::numerics::random;"),
        (&pure, "use super::beam::Section;"),
        (&shell, "use crate::analysis::track::State;"),
        (&shell, "use crate::recording::import::How;"),
        (&recording, "use tirante_analysis::track::State;"),
        (&recording, "use crate::part;"),
        (&shell, "mod tests { use super::*; }"),
        (
            &shell,
            "// crate::site::store::Store\nlet s = \"crate::site::store\";",
        ),
        (&shell, "let s = r#\"crate::site::\"store\"#;"),
    ] {
        assert_eq!(upward(module, text), Vec::<String>::new(), "{text}");
    }
    let nowhere = ["cellar".to_owned()];
    assert_eq!(upward(&nowhere, "").len(), 1);
}

#[test]
fn every_way_to_reach_outside_is_seen() {
    let module: Vec<String> = ["analysis", "rod", "prior"].map(str::to_owned).to_vec();
    for text in [
        "use std::fs;",
        "use std::{collections::HashMap, io::{self, Read}};",
        "let now = std::time::Instant::now();",
        "use std::time::{Duration, SystemTime};",
        "println!(\"x\");",
        "tracing::warn!(\"x\");",
        "use tokio::sync::mpsc;",
    ] {
        assert!(!impure(&module, text).is_empty(), "{text}");
    }
    assert!(
        impure(
            &module,
            "use std::time::Duration;\n#[cfg(test)]\nmod tests { use std::fs; }"
        )
        .is_empty()
    );
}

#[test]
fn the_library_without_the_daemon_has_no_crate_of_a_server() {
    let crates = |arguments: &[&str]| -> BTreeSet<String> {
        let tree = ["tree", "--locked", "-e", "normal", "--prefix", "none"];
        let output = Command::new(env!("CARGO"))
            .args(tree)
            .args(arguments)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let text = String::from_utf8(output.stdout).unwrap();
        let names = text.lines().filter_map(|line| line.split(' ').next());
        names.map(str::to_owned).collect()
    };
    let (with, without) = (
        crates(&["-p", "tirante"]),
        crates(&["-p", "tirante", "--no-default-features"]),
    );
    assert!(without.contains("tirante-analysis") && without.is_subset(&with));
    for server in [
        "axum",
        "clap",
        "hyper",
        "lettre",
        "ring",
        "rumqttc",
        "rusqlite",
        "rustls",
        "tokio",
        "tungstenite",
        "ureq",
    ] {
        assert!(with.contains(server), "{server} is not part of the program");
        assert!(!without.contains(server), "{server} is part of the library");
    }
    // The Python package is that library.
    assert!(!crates(&["-p", "tirante-python"]).contains("rusqlite"));
}
