//! Files that the package ships besides the program: unit, default configuration, alert rules, dashboard, man
//! pages.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::collections::BTreeSet;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

fn project() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn shipped(name: &str) -> PathBuf {
    project().join("systemd").join(name)
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn tirante() -> Command {
    Command::new(env!("CARGO_BIN_EXE_tirante"))
}

/// Runs a tool of the system, which must succeed; skipped on a machine without it.
fn if_installed(command: &mut Command) {
    match command.output() {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            eprintln!("skipped: {} is not installed", command.get_program().display());
        }
        Err(error) => panic!("{command:?}: {error}"),
        Ok(output) => assert!(
            output.status.success(),
            "{command:?}:\n{}{}",
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr)
        ),
    }
}

#[test]
fn the_sandbox_leaves_an_exposure_of_2_or_less() {
    for unit in ["tirante.service", "tirante-hub.service", "tirante-work.service"] {
        if_installed(
            Command::new("systemd-analyze")
                .args(["security", "--offline=true", "--threshold=20"])
                .arg(shipped(unit)),
        );
    }
}

#[test]
fn systemd_understands_the_units() {
    let folder = tempfile::tempdir().unwrap();
    for (unit, page) in [
        ("tirante.service", "man:tirante-run(1) "),
        ("tirante-hub.service", "man:tirante-hub(1) "),
        ("tirante-work.service", "man:tirante-work(1) "),
    ] {
        let service = text(&shipped(unit));
        assert!(service.contains(page));
        let service = service
            .replace("/usr/bin/tirante", env!("CARGO_BIN_EXE_tirante"))
            .replace(page, "");
        fs::write(folder.path().join(unit), service).unwrap();
    }
    fs::copy(shipped("tirante.socket"), folder.path().join("tirante.socket")).unwrap();
    if_installed(
        Command::new("systemd-analyze")
            .arg("verify")
            .arg(folder.path().join("tirante.service"))
            .arg(folder.path().join("tirante-hub.service"))
            .arg(folder.path().join("tirante-work.service"))
            .arg(folder.path().join("tirante.socket")),
    );
}

#[test]
fn the_unit_keeps_the_promises_of_the_program() {
    let unit = text(&shipped("tirante.service"));
    for line in [
        "Type=notify",
        "RestartPreventExitStatus=2",
        "ExecReload=/bin/kill -HUP $MAINPID",
        "ExecStart=/usr/bin/tirante run --config /etc/tirante/tirante.toml",
        "User=tirante",
        "StateDirectory=tirante",
    ] {
        assert!(unit.lines().any(|other| other == line), "no {line}");
    }
    // Hub and workers end if post or database are not there yet: they are begun again until they are.
    for (unit, command) in [("tirante-hub.service", "hub"), ("tirante-work.service", "work")] {
        let unit = text(&shipped(unit));
        for line in [
            format!("ExecStart=/usr/bin/tirante {command} --config /etc/tirante/hub.toml"),
            "Restart=on-failure".to_owned(),
            "RestartPreventExitStatus=2".to_owned(),
            "StartLimitIntervalSec=0".to_owned(),
            "User=tirante".to_owned(),
        ] {
            assert!(unit.lines().any(|other| *other == line), "no {line}");
        }
    }
    let users = text(&shipped("tirante.sysusers"));
    assert!(users.lines().any(|line| line.starts_with("u tirante ")));
    let paths = text(&shipped("tirante.tmpfiles"));
    assert!(paths.contains("/etc/tirante/tirante.toml 0640 root tirante"));
}

/// Exit code and stderr of `tirante check --quiet`.
fn check(path: &Path) -> (Option<i32>, String) {
    let output = tirante().args(["check", "--quiet"]).arg(path).output().unwrap();
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

#[test]
fn the_default_configuration_is_refused_until_a_rod_is_described_and_then_holds() {
    let (code, said) = check(&shipped("tirante.toml"));
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("rod: is missing"), "{said}");
    assert!(said.ends_with("1 fault\n"), "nothing else is wrong: {said}");

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tirante.toml");
    let described: String = text(&shipped("tirante.toml"))
        .lines()
        .map(|line| match line.strip_prefix('#') {
            Some(key) if !key.starts_with(' ') => format!("{key}\n"),
            _ => format!("{line}\n"),
        })
        .collect();
    fs::write(&path, described).unwrap();
    let (code, said) = check(&path);
    assert_eq!(code, Some(0), "{said}");
}

/// Every metric an expression names.
fn metrics_in(expression: &str) -> BTreeSet<String> {
    expression
        .split(|c: char| !c.is_ascii_alphanumeric() && c != '_')
        .filter(|word| word.starts_with("tirante_") || word.starts_with("process_"))
        .map(str::to_owned)
        .collect()
}

/// True if docs/metrics.md lists a metric; tests/service/metrics.rs compares that list with the program.
fn is_listed(metric: &str) -> bool {
    let page = text(&project().join("docs/metrics.md"));
    let series = ["_bucket", "_sum", "_count"]
        .iter()
        .find_map(|end| metric.strip_suffix(end))
        .filter(|name| page.contains(&format!("| `{name}` | histogram |")));
    page.contains(&format!("| `{}` |", series.unwrap_or(metric)))
}

#[test]
fn every_metric_of_the_alert_rules_exists_and_prometheus_accepts_them() {
    let rules = text(&shipped("alerts.yml"));
    let expressions: String = rules
        .lines()
        .filter(|line| !line.trim_start().starts_with('#'))
        .collect::<Vec<_>>()
        .join("\n");
    let named = metrics_in(&expressions);
    assert!(named.len() >= 10, "{named:?}");
    for metric in named {
        assert!(is_listed(&metric), "{metric} is not in docs/metrics.md");
    }
    if_installed(
        Command::new("promtool")
            .args(["check", "rules"])
            .arg(shipped("alerts.yml")),
    );
}

#[test]
fn the_alert_rules_speak_when_they_should() {
    let folder = tempfile::tempdir().unwrap();
    fs::copy(shipped("alerts.yml"), folder.path().join("alerts.yml")).unwrap();
    let histories = folder.path().join("histories.yml");
    fs::copy(project().join("tests/command/alert-rules.yml"), &histories).unwrap();
    if_installed(Command::new("promtool").args(["test", "rules"]).arg(histories));
}

#[test]
fn every_metric_of_the_dashboard_exists() {
    let dashboard: serde_json::Value = serde_json::from_str(&text(&shipped("dashboard.json"))).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    assert!(panels.len() >= 15);
    for panel in panels {
        let targets = panel["targets"].as_array().unwrap();
        assert!(!targets.is_empty(), "{}", panel["title"]);
        for target in targets {
            let named = metrics_in(target["expr"].as_str().unwrap());
            assert!(!named.is_empty(), "{target}");
            for metric in named {
                assert!(
                    is_listed(&metric),
                    "{metric} of {} is not in docs/metrics.md",
                    panel["title"]
                );
            }
        }
    }
    assert!(!is_listed("tirante_nothing") && !is_listed("tirante_clients_bucket"));
}

#[test]
fn every_command_has_a_man_page_and_every_shell_its_completions() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a/b");
    let status = tirante().args(["manual", "--out"]).arg(&out).status().unwrap();
    assert!(status.success());
    for command in ["run", "replay", "status", "check", "alarm-design", "completions"] {
        let page = text(&out.join(format!("tirante-{command}.1")));
        assert!(page.contains(".SH SYNOPSIS"), "{command}");
    }
    assert!(text(&out.join("tirante.1")).contains("axial force"));
    assert!(!out.join("tirante-manual.1").exists(), "it is for packages only");
    assert!(!out.join("tirante-trial.1").exists(), "it is for the daemon only");
    for (shell, name) in [
        ("bash", "tirante.bash"),
        ("zsh", "_tirante"),
        ("fish", "tirante.fish"),
    ] {
        let script = text(&out.join(name));
        assert!(script.contains("rebaseline"), "{name}");
        let mut trials = script.lines().filter(|line| line.contains("trial"));
        // The help of `study --quick` has the word.
        assert!(trials.all(|line| line.contains("as a trial")), "{name}");
        let printed = tirante().args(["completions", shell]).output().unwrap();
        assert_eq!(String::from_utf8_lossy(&printed.stdout), script);
    }

    fs::write(folder.path().join("file"), "").unwrap();
    let refused = tirante()
        .args(["manual", "--out"])
        .arg(folder.path().join("file"))
        .output()
        .unwrap();
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("cannot be written"));
}

#[test]
fn a_reader_of_completions_that_has_gone_is_no_panic() {
    let mut child = tirante()
        .args(["completions", "zsh"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(child.wait().unwrap().success() && said.is_empty(), "{said}");
}

#[test]
fn everything_the_package_takes_from_the_project_is_there() {
    let manifest: toml::Table = toml::from_str(&text(&project().join("Cargo.toml"))).unwrap();
    let deb = &manifest["package"]["metadata"]["deb"];
    let mut taken = 0;
    for asset in deb["assets"].as_array().unwrap() {
        let from = asset[0].as_str().unwrap();
        if !from.starts_with("target/") {
            let folder = project().join(from.split_once('*').map_or(from, |(folder, _)| folder));
            assert!(folder.exists(), "{from}");
            taken += 1;
        }
    }
    assert!(taken >= 8);
    for script in ["postinst", "prerm", "postrm"] {
        if_installed(Command::new("sh").arg("-n").arg(shipped("debian").join(script)));
    }
}

/// Output of a command that must succeed.
fn output(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(
        output.status.success(),
        "{command:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn the_image_holds_the_program_and_no_shell() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("tiny.rs"), "fn main() { println!(\"it runs\"); }").unwrap();
    let tiny = path("tiny");
    output(
        Command::new("rustc")
            .args(["-C", "target-feature=+crt-static", "-o"])
            .args([&tiny, &path("tiny.rs")]),
    );
    let script = || {
        let mut command = Command::new("bash");
        command.arg(shipped("image.sh"));
        command
    };
    for name in ["a.tar", "b.tar"] {
        output(script().arg("--binary").arg(&tiny).arg("--out").arg(path(name)));
    }
    assert_eq!(fs::read(path("a.tar")).unwrap(), fs::read(path("b.tar")).unwrap());

    output(
        Command::new("tar")
            .arg("-xf")
            .arg(path("a.tar"))
            .arg("-C")
            .arg(folder.path()),
    );
    let blob = |digest: &serde_json::Value| {
        let name = digest.as_str().unwrap().strip_prefix("sha256:").unwrap();
        let blob = path("blobs/sha256").join(name);
        let sum = output(Command::new("sha256sum").arg(&blob));
        assert_eq!(sum.split_whitespace().next(), Some(name));
        blob
    };
    let json = |path: &Path| -> serde_json::Value { serde_json::from_str(&text(path)).unwrap() };
    let index = json(&path("index.json"));
    let manifest = json(&blob(&index["manifests"][0]["digest"]));
    let config = json(&blob(&manifest["config"]["digest"]));
    assert_eq!(config["config"]["Entrypoint"][0], "/usr/bin/tirante");
    let layer = blob(&manifest["layers"][0]["digest"]);
    let files = output(Command::new("tar").arg("-tzf").arg(&layer));
    let files: Vec<&str> = files.lines().filter(|name| !name.ends_with('/')).collect();
    assert_eq!(files, ["./etc/group", "./etc/passwd", "./usr/bin/tirante"]);
    let inner = output(
        Command::new("bash")
            .arg("-c")
            .arg(format!("zcat < {} | sha256sum", layer.display())),
    );
    let inner = format!("sha256:{}", inner.split_whitespace().next().unwrap());
    assert_eq!(config["rootfs"]["diff_ids"][0], *inner);
    output(
        Command::new("tar")
            .arg("-xzf")
            .arg(&layer)
            .arg("-C")
            .arg(folder.path())
            .arg("./usr"),
    );
    assert_eq!(output(&mut Command::new(path("usr/bin/tirante"))), "it runs\n");

    let refused = script()
        .args(["--binary", "/bin/ls", "--out"])
        .arg(path("c.tar"))
        .output()
        .unwrap();
    assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("not static"));
}
