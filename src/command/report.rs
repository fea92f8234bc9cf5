//! `tirante report`: writes a store's content as one page per site.

use super::which_store::{WhichStore, check_rod};
use crate::analysis::rod::beam::Quantity;
use crate::analysis::rod::prior::Prior;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::Interval;
use crate::analysis::track::fold::state::Opening;
use crate::command::report_page;
use crate::command::report_page::view::{
    RecordPoint, RejectionCount, RodReport, SegmentReport, SiteReport, ThermalLine,
};
use crate::config::{Config, RodConfig};
use crate::recording::atomic::AtomicFile;
use crate::site::record_row::RecordRow;
use crate::site::store::{Filter, Reader, Standing};
use anyhow::Context;
use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Write the report of a site as one HTML page.
///
/// The page has figures, tables and alarms of every rod, and needs no network and no other file.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante report --store todi.db --out todi.html
  tirante report --config site.toml --out reports/ --rod north

The same store gives the same page, byte for byte. It may be written beside a
running `replay`.")]
pub struct Args {
    /// Store to read.
    #[command(flatten)]
    pub which: WhichStore,

    /// Folder, in which the page is named after the site, or the page itself (*.html).
    #[arg(long, value_name = "DIR|FILE", default_value = ".")]
    pub out: PathBuf,

    /// Only this rod.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,
}

/// Runs the command.
///
/// # Errors
/// No store, one that cannot be read, a rod that is not in it, or a page that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let reader = Reader::open(&args.which.path()?)?;
    let rod = check_rod(&reader, args.rod.as_deref())?;
    let page = write(&reader, rod.as_ref(), &args.out)?;
    let older = reader.without_line(&Filter {
        rod,
        ..Filter::default()
    })?;
    if older.records > 0 {
        tell!(
            "{} older records have no JSON line any more (keep_lines_d): they are counted, but the figures over time begin after them",
            older.records
        );
    }
    super::print(format!("{}\n", page.display()).as_bytes())
}

/// Writes the page of a store into the folder, or to the `*.html` file, `out`; all rods or one. Returns its
/// path.
///
/// # Errors
/// The store cannot be read, or the page cannot be written.
pub fn write(reader: &Reader, rod: Option<&RodId>, out: &Path) -> anyhow::Result<PathBuf> {
    let report = load(reader, rod)?;
    let is_page = out
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("html") || e.eq_ignore_ascii_case("htm"));
    let page = if is_page {
        out.to_owned()
    } else {
        out.join(format!("{}.html", file_name(&report.site)))
    };
    let at = || format!("the report {}", page.display());
    if let Some(folder) = page.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder).with_context(at)?;
    }
    let mut file = AtomicFile::create(&page).with_context(at)?;
    file.write_all(report_page::page(&report).as_bytes())
        .with_context(at)?;
    file.commit().with_context(at)?;
    Ok(page)
}

/// File name for a site's name: letters, digits, `-`, `_`.
fn file_name(site: &str) -> String {
    let mut name = String::new();
    for c in site.chars() {
        if c.is_alphanumeric() || c == '_' {
            name.extend(c.to_lowercase());
        } else if !name.is_empty() && !name.ends_with('-') {
            name.push('-');
        }
    }
    let name: String = name.trim_end_matches('-').chars().take(60).collect();
    if name.is_empty() {
        "report".to_owned()
    } else {
        name
    }
}

/// Reads a store's content as a report; all rods or one.
///
/// # Errors
/// The store cannot be read.
pub fn load(reader: &Reader, rod: Option<&RodId>) -> anyhow::Result<SiteReport> {
    let standings = reader.standings()?;
    let configs = reader.configs()?;
    let states = reader.states()?;
    let mut meaning = Meaning::default();
    let mut rods = Vec::new();
    for standing in standings
        .iter()
        .filter(|standing| rod.is_none_or(|rod| *rod == standing.rod))
    {
        let mut report = load_rod(reader, standing, &mut meaning)?;
        if let Some(state) = states.get(&standing.rod) {
            let slope = state.watch.get().and_then(|watch| watch.slope());
            report.thermal = slope.map(|(slope_per_k, slope_sd_per_k)| ThermalLine {
                slope_per_k,
                slope_sd_per_k,
            });
        }
        rods.push(report);
    }
    // The configuration of the latest record speaks for the site.
    let present = configs
        .iter()
        .find(|[hash, _, _]| meaning.latest.as_ref().is_some_and(|(_, latest)| latest == hash))
        .or(configs.last());
    let config = present.and_then(|[_, _, text]| Config::parse(text, "the store").ok());
    for report in &mut rods {
        let unit = config.as_ref().and_then(|config| config.rod(&report.rod));
        report.motion_unit = unit.map(|rod| rod.channels.displacement.unit.si().to_owned());
        report.facts = unit.map(facts).unwrap_or_default();
        report.baseline_takes = config.as_ref().map(|config| config.track.baseline_records);
    }
    let mut provenance = vec![(
        "program".to_owned(),
        format!("tirante {}", env!("CARGO_PKG_VERSION")),
    )];
    let mut add = |name: &str, values: Vec<String>| {
        if !values.is_empty() {
            provenance.push((name.to_owned(), values.join(", ")));
        }
    };
    add(
        "analysis version",
        meaning.versions.iter().map(u32::to_string).collect(),
    );
    add("configuration", meaning.configs.iter().cloned().collect());
    add(
        "seed of the site",
        config.iter().map(|config| config.seed.to_string()).collect(),
    );
    Ok(SiteReport {
        site: present.map_or_else(|| "Site".to_owned(), |[_, site, _]| site.clone()),
        rods,
        provenance,
    })
}

/// Facts of a rod from its configuration: the priors of its quantities.
fn facts(rod: &RodConfig) -> Vec<(String, String)> {
    let prior = &rod.analysis.prior;
    let mut facts = vec![(
        0,
        "section".to_owned(),
        prior.parameterisation().section().key().to_owned(),
    )];
    for (quantity, known) in prior.parameterisation().quantities().iter().zip(prior.priors()) {
        let (name, unit, factor) = report_page::quantity(quantity.key());
        // The length first, the force last.
        let (place, name) = match quantity {
            Quantity::Length => (-1, name),
            Quantity::AxialForce => (2, "force expected"),
            Quantity::SpringLeft => (1, "left support"),
            Quantity::SpringRight => (1, "right support"),
            _ => (0, name),
        };
        let four = |value: f64| rounded(value * factor, 4);
        let value = match known {
            Prior::Fixed { value } => format!("{} {unit}", four(*value)),
            Prior::Fixity(fixity) => format!("{} to {} (0 hinge, 1 clamp)", fixity.low, fixity.high),
            Prior::Uniform { low, high } | Prior::LogUniform { low, high } => {
                format!("{} to {} {unit}", four(*low), four(*high))
            }
            // Its 95 % range.
            Prior::LogNormal { median, log_sd } => {
                let [low, high] = [-1.96, 1.96].map(|z| four(median * (z * log_sd).exp()));
                format!("{low} to {high} {unit}")
            }
            other => {
                let (mean, sd) = other.mean_and_sd();
                format!("{} {unit} \u{b1} {} %", four(mean), rounded(100.0 * sd / mean, 2))
            }
        };
        facts.push((place, name.to_owned(), value));
    }
    facts.sort_by_key(|(place, ..)| *place);
    facts.into_iter().map(|(_, name, value)| (name, value)).collect()
}

/// A number with so many significant digits.
fn rounded(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits.saturating_sub(1))
        .parse()
        .unwrap_or(value)
}

/// Everything that determines the meaning of the numbers, over all records.
#[derive(Default)]
struct Meaning {
    configs: BTreeSet<String>,
    versions: BTreeSet<u32>,
    /// Time and configuration of the latest record.
    latest: Option<(Timestamp, String)>,
}

fn load_rod(reader: &Reader, standing: &Standing, meaning: &mut Meaning) -> anyhow::Result<RodReport> {
    let rod = &standing.rod;
    let mut report = RodReport::new(&rod.0);
    report.state = Some(standing.state.clone());
    report.segment = Some(standing.segment);
    let filter = Filter {
        rod: Some(rod.clone()),
        ..Filter::default()
    };
    reader.rows(&filter, |row| -> anyhow::Result<()> {
        meaning.see(&row);
        if row.rejection.is_none() {
            report.records.extend(point(row));
        }
        Ok(())
    })?;
    // Counts and provenance are of all records, whether they have a line or not.
    report.older_used = usize::try_from(reader.without_line(&filter)?.used)?;
    for (config, version) in reader.meanings(rod)? {
        meaning.configs.insert(config);
        meaning.versions.extend(version);
    }
    for refusal in reader.refusals(rod)? {
        report.rejections.push(RejectionCount {
            code: refusal.code,
            count: usize::try_from(refusal.count)?,
            last: refusal.last,
            message: refusal.message,
        });
    }
    report
        .rejections
        .sort_by(|a, b| b.count.cmp(&a.count).then_with(|| a.code.cmp(&b.code)));
    report.alarms = reader.alarms(&filter)?;
    report.words = reader.words_of(&report.alarms)?;
    for segment in reader.segments(rod)? {
        let periods = reader.periods(rod, segment.number)?;
        report
            .periods
            .extend(periods.into_iter().map(|period| (segment.number, period)));
        let baseline = segment.baseline.as_ref();
        report.segments.push(SegmentReport {
            number: segment.number,
            reason: match segment.reason {
                Opening::First => "first record",
                Opening::Requested => "on request",
                Opening::Changed => "configuration or program changed",
                Opening::Clock => "the clock had jumped ahead",
            }
            .to_owned(),
            baseline: baseline.map(|baseline| (baseline.first, baseline.last)),
            records: baseline.map_or(0, |baseline| baseline.records),
            overdispersion: baseline.map(|baseline| baseline.overdispersion),
            reference_c: segment.reference_c,
            fault: segment.fault,
        });
    }
    let snapshots = reader.snapshots(rod)?;
    report.baseline = snapshots.first;
    report.latest = snapshots.latest;
    report.refused = snapshots.refused;
    let always = (Timestamp::from_nanos(i64::MIN), Timestamp::MAX);
    let latest = reader.lines_before(rod, always, None, false, 1)?.found.pop();
    report.file = latest.and_then(|line| line.file);
    Ok(report)
}

impl Meaning {
    fn see(&mut self, row: &RecordRow) {
        let is_later = |start: &Timestamp| self.latest.as_ref().is_none_or(|(latest, _)| latest <= start);
        if let Some(start) = row.start.filter(is_later) {
            self.latest = Some((start, row.config.clone()));
        }
    }
}

/// Point of a record that gave a force, for the figures.
fn point(row: RecordRow) -> Option<RecordPoint> {
    Some(RecordPoint {
        force_n: Interval::from(&row.axial_force_n?),
        start: row.start?,
        segment: row.segment,
        tracked_force_n: row.tracked_force_n,
        force_at_reference_n: row.force_at_reference_n,
        ratio: row.relative_force,
        ratio_at_reference: row.relative_force_at_reference,
        temperature_c: row.temperature_c,
        reference_c: row.reference_temperature_c,
        modes: row
            .modes
            .iter()
            .map(|mode| (mode.order, mode.frequency_hz, mode.sd_hz))
            .collect(),
        doubts: row.doubts(),
        set_aside: row.set_aside.map(|aside| aside.code().to_owned()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_called_after_its_site_whatever_the_site_is_called() {
        assert_eq!(file_name("San Fortunato, Todi"), "san-fortunato-todi");
        assert_eq!(file_name("../../etc/passwd"), "etc-passwd");
        assert_eq!(file_name("Sant'Ambrogio – Milano"), "sant-ambrogio-milano");
        assert_eq!(file_name("..."), "report");
        assert_eq!(file_name(&"x".repeat(500)).len(), 60);
    }
}
