//! The paper's study as a whole: the same bytes at any number of threads, files that hold together, and the
//! findings that no choice of random numbers may change.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::program::{ROOT, tirante};
use std::collections::HashMap;
use std::path::Path;
use tirante::analysis::lab::study::{self, Effort, Study};
use tirante::command::report_page;

/// Least effort that runs every part.
const LITTLE: Effort = Effort {
    abc_runs: 2,
    mcmc_runs: 2,
    abc_draws: 6_000,
    many_draws: 12_000,
    mcmc_steps: 16 * 200,
    rods: 2,
    epochs: 1,
};

/// A study whose progress ends where it was said to end.
fn study(threads: usize, seed: u64) -> Study {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    let last = std::sync::Mutex::new((0, 0));
    let progress = |_: &str, done: usize, all: usize| {
        let mut last = last.lock().unwrap();
        *last = (done.max(last.0), all);
    };
    let study = pool.install(|| study::run(LITTLE, seed, &progress)).unwrap();
    let (done, all) = last.into_inner().unwrap();
    assert_eq!(done, all);
    study
}

#[test]
fn the_same_seed_gives_the_same_page_at_any_number_of_threads() {
    let one = study(1, 3);
    let page = report_page::study(&one);
    assert_eq!(page, report_page::study(&study(3, 3)));
    assert!(!page.contains("NaN"), "a figure without a value is shown");
    let count = |tag: &str| {
        (
            page.matches(&format!("<{tag}")).count(),
            page.matches(&format!("</{tag}>")).count(),
        )
    };
    for tag in ["svg", "table", "figure", "section", "main"] {
        let (opened, closed) = count(tag);
        assert_eq!(opened, closed, "{tag}");
    }
    // Per setting: figures 5 and 7 of four quantities, 6 of three measures, 8 of two, two of each of two
    // chains, one predictive; figure 4 once.
    assert_eq!(count("svg").0, 2 * (4 + 4 + 3 + 2 + 4 + 1) + 1);
}

/// Numbers by part, column, quantity and statistic.
fn numbers(path: &Path) -> HashMap<[String; 4], (Option<f64>, f64)> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    assert_eq!(
        lines.next(),
        Some("part,column,quantity,statistic,paper,ours,error_of_one_run,runs,deviation")
    );
    let row = |line: &str| {
        let (mut fields, mut quoted) = (vec![String::new()], false);
        for c in line.chars() {
            match c {
                '"' => quoted = !quoted,
                ',' if !quoted => fields.push(String::new()),
                c => fields.last_mut().unwrap().push(c),
            }
        }
        assert_eq!(fields.len(), 9, "{line}");
        let key = std::array::from_fn(|i| fields[i].clone());
        (key, (fields[4].parse().ok(), fields[5].parse().unwrap()))
    };
    let all: Vec<_> = lines.map(row).collect();
    let count = all.len();
    let map: HashMap<_, _> = all.into_iter().collect();
    assert_eq!(map.len(), count, "two numbers of one name");
    map
}

#[test]
fn the_command_writes_a_report_whose_findings_stand() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("new/study");
    let line = format!("study --quick --json --seed 5 --out {}", out.display());
    let printed = tirante(ROOT, &line).done();
    let json: serde_json::Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(
        std::fs::read_to_string(out.join("study.json")).unwrap(),
        printed,
        "the file and stdout are the same"
    );
    let numbers = numbers(&out.join("numbers.csv"));
    assert_eq!(json["numbers"].as_array().unwrap().len(), numbers.len());
    assert!(out.join("study.html").exists());
    let curves = std::fs::read_to_string(out.join("curves.csv")).unwrap();
    assert!(
        curves.starts_with("figure,setting,curve,quantity,x,y\n4")
            || curves.contains("\n7,as-inferred,nf = 5,")
    );

    let number = |part: &str, column: &str, quantity: &str, statistic: &str| {
        let key = [part, column, quantity, statistic].map(str::to_owned);
        *numbers.get(&key).unwrap_or_else(|| panic!("{key:?}"))
    };
    // Table 3 comes out for three frequencies and more, in both settings.
    for setting in ["as-printed", "as-inferred"] {
        for nf in 3..=5 {
            let (paper, ours) = number(
                &format!("Table 3, {setting}"),
                &format!("nf = {nf}"),
                "axial_force_n",
                "mean",
            );
            assert!(
                (paper.unwrap() / ours - 1.0).abs() < 0.05,
                "{setting} {nf} {ours}"
            );
        }
    }
    // The printed error variance drives the modulus to zero, whatever the model behind the chain.
    for model in ["finite-elements", "exact", "reduced", "pce", "ann"] {
        let (_, e) = number(
            "Table 2, as-printed",
            &format!("MCMC, {model}"),
            "youngs_modulus_pa",
            "mean",
        );
        assert!(e < 1e10, "{model} {e}");
    }
    // ABC does not see that, and the elements, the exact model and the reduced emulator are one to it.
    for model in ["finite-elements", "exact", "reduced", "pce", "ann"] {
        let (_, e) = number(
            "Table 2, as-inferred",
            &format!("ABC, {model}"),
            "youngs_modulus_pa",
            "mean",
        );
        assert!((1.45e11..1.7e11).contains(&e), "{model} {e}");
    }
    // More measurements, more certainty: five modes against one, and everything against nothing.
    let worth = |name: &str| number("worth of measurements", name, "axial_force_n", "cv").1;
    assert!(worth("five modes") < worth("one mode"));
    assert!(worth("caliper, density, modulus") < 0.5 * worth("three modes, 10 mHz each"));
    // Springs hardly matter, whichever way the index is found.
    for way in ["chaos", "Monte Carlo"] {
        let (_, spring) = number(
            "Sobol indices",
            "mode 1",
            "spring_left_n_m",
            &format!("total, {way}"),
        );
        assert!(spring < 0.01, "{way} {spring}");
    }
    // The ladder's top rung is the exact posterior: MCMC agrees with it.
    let rung = |name: &str, statistic: &str| number("ladder of samplers", name, "axial_force_n", statistic).1;
    let exact = "exact (importance sampling)";
    let off = (rung("MCMC", "mean") - rung(exact, "mean")) / rung(exact, "sd");
    assert!(off.abs() < 0.2, "{off}");
    let claims = json["claims"].as_array().unwrap();
    let verdict = |part: &str| {
        let claim = claims
            .iter()
            .find(|c| c["statement"].as_str().unwrap().contains(part));
        claim.unwrap_or_else(|| panic!("{part}"))["verdict"]
            .as_str()
            .unwrap()
            .to_owned()
    };
    assert_eq!(verdict("cannot come from the model"), "holds");
    assert_eq!(verdict("cannot give Table 2"), "holds");
    assert_eq!(verdict("in case C the divergence of N"), "fails");
}

#[test]
fn a_folder_that_cannot_be_made_is_told_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    let begun = std::time::Instant::now();
    tirante(&folder, "study --out file/study")
        .ends(1)
        .says(&["the folder"]);
    assert!(begun.elapsed().as_secs() < 30);
}
