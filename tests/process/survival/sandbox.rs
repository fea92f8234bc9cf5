//! The daemon confined to the rights of its unit: a read-only system, one writable folder, no capabilities,
//! and no system call, address family or writable code beyond the unit's. First under the unit's own filter,
//! which the kernel enforces; then under `strace`, which shows what it would have asked for.

use super::campaign::{Campaign, Material};
use super::watchdog::{free_port, status};
use seccompiler::{BpfMap, TargetArch};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::process::Command;

const UNIT: &str = include_str!("../../../systemd/tirante.service");

const PROGRAM: &str = env!("CARGO_BIN_EXE_tirante");

fn has(program: &str) -> bool {
    let has = Command::new(program).arg("--version").output().is_ok();
    assert!(
        has || std::env::var_os("TIRANTE_REAL_PEERS").is_none(),
        "no {program}"
    );
    if !has {
        eprintln!("skipped: no {program}");
    }
    has
}

/// System calls that the unit's filter allows, by systemd's own lists.
fn allowed() -> BTreeSet<String> {
    let output = Command::new("systemd-analyze")
        .arg("syscall-filter")
        .output()
        .unwrap();
    let mut groups = BTreeMap::<String, Vec<String>>::new();
    let mut group = String::new();
    for line in String::from_utf8(output.stdout).unwrap().lines() {
        if line.starts_with('@') {
            group = line.trim().to_owned();
        } else if line.starts_with(' ') && !line.trim().starts_with('#') {
            groups
                .entry(group.clone())
                .or_default()
                .push(line.trim().to_owned());
        }
    }
    let mut allowed = BTreeSet::new();
    for filter in UNIT
        .lines()
        .filter_map(|line| line.strip_prefix("SystemCallFilter="))
    {
        let (is_denied, names) = filter
            .strip_prefix('~')
            .map_or((false, filter), |names| (true, names));
        let mut waiting: Vec<String> = names.split_whitespace().map(str::to_owned).collect();
        while let Some(name) = waiting.pop() {
            if let Some(names) = groups.get(&name) {
                waiting.extend(names.iter().cloned());
            } else if is_denied {
                allowed.remove(&name);
            } else {
                allowed.insert(name);
            }
        }
    }
    allowed
}

/// The unit's filter in the kernel's form: calls that are not allowed fail with `EPERM`, as the unit sets.
fn compiled(allowed: &BTreeSet<String>) -> Vec<u8> {
    assert!(UNIT.contains("\nSystemCallErrorNumber=EPERM\n"));
    let arch = TargetArch::try_from(std::env::consts::ARCH).unwrap();
    let compile = |names: &[&String]| -> Option<BpfMap> {
        let rules: Vec<_> = names
            .iter()
            .map(|name| serde_json::json!({ "syscall": name }))
            .collect();
        let filter = serde_json::json!({
            "unit": { "mismatch_action": { "errno": 1 }, "match_action": "allow", "filter": rules }
        });
        seccompiler::compile_from_json(filter.to_string().as_bytes(), arch).ok()
    };
    // Some names are of other machines.
    let known: Vec<_> = allowed
        .iter()
        .filter(|name| compile(&[*name]).is_some())
        .collect();
    assert!(known.len() > 200, "{known:?}");
    let filters = compile(&known).unwrap();
    let mut bytes = Vec::new();
    for step in &filters["unit"] {
        bytes.extend(step.code.to_ne_bytes());
        bytes.extend([step.jt, step.jf]);
        bytes.extend(step.k.to_ne_bytes());
    }
    bytes
}

fn confined<'a>(folder: &'a str, state: &'a str) -> Vec<&'a str> {
    let mut words = vec![
        "bwrap",
        "--die-with-parent",
        "--unshare-ipc",
        "--unshare-uts",
        "--cap-drop",
        "ALL",
        // An ordinary user, as in the unit: as root, SQLite would give its files to the store's owner.
        "--unshare-user",
        "--uid",
        "1000",
        "--gid",
        "1000",
    ];
    words.extend([
        "--ro-bind",
        "/",
        "/",
        "--dev",
        "/dev",
        "--proc",
        "/proc",
        "--tmpfs",
        "/tmp",
    ]);
    words.extend(["--ro-bind", folder, folder, "--bind", state, state]);
    // The project itself may lie below /tmp.
    words.extend(["--ro-bind", PROGRAM, PROGRAM]);
    words
}

#[test]
fn the_campaign_passes_inside_the_units_sandbox() {
    if !(has("bwrap") && has("strace") && has("systemd-analyze")) {
        return;
    }
    let allowed = allowed();
    assert!(
        allowed.contains("openat") && !allowed.contains("setpriority"),
        "{allowed:?}"
    );
    let port = free_port();
    let http = format!("[http]\nlisten = \"127.0.0.1:{port}\"\n");
    let campaign = Campaign::new(Material::long(), &http);
    let mut feed = campaign.feed();
    campaign.material.undisturbed();
    let (folder, state) = (
        campaign.folder.path().to_str().unwrap().to_owned(),
        campaign.path("state"),
    );
    let state = state.to_str().unwrap();
    let trace = format!("{state}/trace");
    let words = confined(&folder, state);
    fs::write(campaign.path("filter"), compiled(&allowed)).unwrap();
    // The shell hands the filter over as an open file.
    let under_filter = ["sh", "-c", "exec \"$@\" 9<filter", "sh"];
    let filtered = [&under_filter[..], &words[..1], &["--seccomp", "9"], &words[1..]].concat();

    // The filter is active: calls that the unit denies fail.
    let mut denied = Command::new(filtered[0]);
    let denied = denied.args(&filtered[1..]).args(["nice", "-n", "1", "true"]);
    let said = denied.current_dir(&folder).output().unwrap();
    let said = String::from_utf8_lossy(&said.stderr).into_owned();
    assert!(said.contains("cannot set niceness"), "{said}");

    let mut daemon = campaign.start(&filtered);
    feed.offer(0.6);
    daemon.wait_until("records come by every way", |_| campaign.records() > 60);
    assert!(status(port).starts_with("HTTP/1.1 200"), "{}", status(port));
    daemon.stop("-TERM");
    let daemon = campaign.start(&[&words[..], &["strace", "-f", "-qq", "-o", &trace][..]].concat());
    campaign.finish_with(&mut feed, daemon);
    campaign.check("sandbox", false);

    let families: BTreeSet<&str> = UNIT
        .lines()
        .find_map(|line| line.strip_prefix("RestrictAddressFamilies="))
        .unwrap()
        .split_whitespace()
        .collect();
    let mut calls = BTreeMap::<String, usize>::new();
    for line in fs::read_to_string(&trace).unwrap().lines() {
        let line = line
            .trim_start_matches(|letter: char| letter.is_ascii_digit())
            .trim_start();
        let Some((name, rest)) = line.split_once('(') else {
            continue;
        };
        if !name
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
        {
            continue;
        }
        *calls.entry(name.to_owned()).or_default() += 1;
        if matches!(name, "socket" | "socketpair") {
            assert!(families.contains(rest.split(',').next().unwrap()), "{line}");
        }
        if matches!(name, "mmap" | "mprotect" | "pkey_mprotect") {
            assert!(
                !(rest.contains("PROT_WRITE") && rest.contains("PROT_EXEC")),
                "{line}"
            );
            assert!(!(name == "mprotect" && rest.contains("PROT_EXEC")), "{line}");
        }
    }
    let beyond: Vec<_> = calls.keys().filter(|name| !allowed.contains(*name)).collect();
    assert!(
        beyond.is_empty(),
        "not in the unit's SystemCallFilter: {beyond:?}"
    );
    println!("{} different system calls, all allowed: {calls:?}", calls.len());
}
