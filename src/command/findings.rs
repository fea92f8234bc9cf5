//! Findings of a record as text of at most 80 columns: its peaks and their nature, marks of doubt, sources of
//! the force's variance.

use super::listing::hanging;
use crate::analysis::findings::{
    CONFLICT_SHOWN, Candidate, Doubt, PRIOR_TAIL_SHOWN, is_wide, motion_said, three_digits,
};
use crate::analysis::identify::Measurement;
use crate::analysis::inference::{Conflict, Marginal, VarianceShares};
use crate::analysis::outcome::Rejected;
use crate::analysis::record_view::{PeakMark, Snapshot};
use crate::analysis::signal::record::Timestamp;
use std::fmt::Write;

/// Most characters of a line.
const WIDTH: usize = 80;
/// Candidates listed.
const CANDIDATES: usize = 5;

/// Record, motion and flags, one line each.
pub fn opening(measurement: &Measurement) -> Vec<String> {
    let mut lines = vec![
        format!(
            "  record of {:.1} s at {:.2} Hz, {}",
            measurement.duration_s,
            measurement.fs_hz,
            began(measurement.start)
        ),
        format!("  {}", motion_said(&measurement.motion)),
    ];
    lines.extend(measurement.flags.iter().map(|flag| format!("  noticed: {flag}")));
    lines
}

/// Start of a record in words; a file without a start counts from 1970, in which nobody recorded.
pub fn began(start: Timestamp) -> String {
    const YEAR_NS: i64 = 365 * 86_400 * 1_000_000_000;
    match start.as_nanos() {
        0 => "its time not said".to_owned(),
        later @ 1..YEAR_NS => format!("from {:.2} s on, its time not said", later as f64 * 1e-9),
        _ => format!("from {start}"),
    }
}

/// Rejection of a record, with the findings in it.
pub fn refused(rejected: &Rejected) -> String {
    let rejection = &rejected.rejection;
    let words = format!("{}: rejected ({}): {rejection}", rejected.rod, rejection.code());
    let mut text = hanging(&words, 0, 2).join("\n") + "\n";
    let Some(measurement) = &rejected.measurement else {
        return text;
    };
    for line in opening(measurement) {
        text += &(line + "\n");
    }
    if let Some(picture) = Snapshot::of_rejected(rejected) {
        if !picture.peaks.is_empty() {
            text += &format!("\n{}", peaks(&picture.peaks));
        }
        if !picture.candidates.is_empty() {
            text += &format!("\n{}", candidates(&picture.candidates));
        }
    }
    text
}

/// Marks of a force that may be wrong: model or prior against the data, and an interval that hardly tells it.
pub fn doubts(conflict: &Conflict, force: Option<&Marginal>) -> Vec<String> {
    let mut lines = disagreement(conflict);
    if force.is_some_and(|force| is_wide(force.interval())) {
        lines.extend(wrapped("  ? ", Doubt::Wide.said()).lines().map(str::to_owned));
    }
    lines
}

fn disagreement(conflict: &Conflict) -> Vec<String> {
    if conflict.score >= CONFLICT_SHOWN {
        let reason = conflict
            .violation
            .map(|violation| format!(": {violation}"))
            .unwrap_or_default();
        vec![
            format!("  ! model and data disagree{reason}"),
            "    the force may be wrong by more than its interval says".to_owned(),
        ]
    } else if conflict.prior_tail <= PRIOR_TAIL_SHOWN {
        let share = match conflict.prior_tail {
            tail if tail < 1e-3 => "less than 0.1".to_owned(),
            tail => format!("{:.1}", 100.0 * tail),
        };
        let said = format!(
            "prior and data disagree: {share} % of the rods the prior allows lie as far out; check length, section, material and the \
             expected force"
        );
        wrapped("  ! ", &said).lines().map(str::to_owned).collect()
    } else {
        Vec::new()
    }
}

/// Sources of the force's variance with their shares.
pub fn hangs_on(shares: &VarianceShares) -> String {
    let mut text = format!(
        "  {:<24} {:>8}   {:>24}\n",
        "what the force hangs on", "share", "less variance if known"
    );
    for part in &shares.sources {
        text += &format!(
            "  {:<24} {:>6.0} %   {:>22.0} %\n",
            part.source.name(),
            100.0 * part.share,
            100.0 * part.if_known
        );
    }
    for sentence in &shares.said {
        text += &wrapped("  ", sentence);
    }
    text
}

/// A force with its 95 % interval: `560 kN (430 to 701)`.
pub fn force(force: &Marginal) -> String {
    let kn = |newtons: f64| three_digits(1e-3 * newtons);
    format!("{} kN ({} to {})", kn(force.mean), kn(force.q025), kn(force.q975))
}

/// Decimals that show two digits of a frequency's standard error, as far as a person reads them.
pub fn decimals(sd_hz: Option<f64>) -> usize {
    match sd_hz {
        Some(sd_hz) if sd_hz > 0.0 => (1.0 - sd_hz.log10().floor()).clamp(1.0, 6.0) as usize,
        _ => 3,
    }
}

/// Every peak with its standard error, damping, level over the noise floor, and nature.
pub fn peaks(peaks: &[PeakMark]) -> String {
    let mut text = format!(
        "  {:>14}  {:>10}  {:>11}  {:>10}  taken for\n",
        "frequency [Hz]", "error [Hz]", "damping [%]", "level [dB]"
    );
    for peak in peaks {
        let decimals = decimals(peak.sd_hz);
        let number = |value: Option<f64>, decimals: usize| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
        };
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "  {:>14}  {:>10}  {:>11}  {:>10}  {}",
            format!("{:.decimals$}", peak.frequency_hz),
            number(peak.sd_hz, decimals),
            number(peak.damping.map(|damping| 100.0 * damping), 3),
            number(peak.level_db, 1),
            peak.said(),
        );
    }
    text
}

/// Assignments of peaks to mode orders, likeliest first, each with the force it implies.
pub fn candidates(candidates: &[Candidate]) -> String {
    let mut text = format!("  {:>11}  {:<24}  modes\n", "probability", "force [kN]");
    for candidate in candidates.iter().take(CANDIDATES) {
        let force = candidate.axial_force_n.map_or_else(
            || "-".to_owned(),
            |force| {
                let [low, middle, high] =
                    [force.q025, force.q50, force.q975].map(|newtons| three_digits(1e-3 * newtons));
                format!("{middle} ({low} to {high})")
            },
        );
        let opening = format!("  {:>11}  {force:<24}  ", probability(candidate.probability));
        text += &wrapped(&opening, &candidate.said());
    }
    match candidates.len().saturating_sub(CANDIDATES) {
        0 => {}
        more => {
            let _ = writeln!(text, "  and {more} more");
        }
    }
    text
}

/// A probability that is never rounded to 0 or 1 unless certain.
pub fn probability(probability: f64) -> String {
    match probability {
        p if p > 0.9999 && p < 1.0 => "> 0.9999".to_owned(),
        p if p < 0.0001 && p > 0.0 => "< 0.0001".to_owned(),
        p if !(0.01..=0.99).contains(&p) => format!("{p:.4}"),
        p => format!("{p:.2}"),
    }
}

/// Text after an opening, wrapped between words, further lines indented by the opening.
pub fn wrapped(opening: &str, text: &str) -> String {
    let indent = opening.chars().count();
    let mut out = String::from(opening);
    let mut column = indent;
    for word in text.split_whitespace() {
        let length = word.chars().count();
        if column > indent && column + 1 + length > WIDTH {
            let _ = write!(out, "\n{:indent$}", "");
            column = indent;
        }
        if column > indent {
            out.push(' ');
            column += 1;
        }
        out.push_str(word);
        column += length;
    }
    let trimmed = out.trim_end().len();
    out.truncate(trimmed);
    out.push('\n');
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::findings::{Assigned, Multiple, Nature, Quantiles};

    #[test]
    fn a_later_stretch_of_a_file_without_a_start_has_no_date() {
        assert_eq!(began(Timestamp::from_nanos(0)), "its time not said");
        let later = began(Timestamp::from_nanos(2_097_250_000_000));
        assert_eq!(later, "from 2097.25 s on, its time not said");
        let dated = Timestamp::from_nanos(1_772_344_800_000_000_000);
        assert_eq!(began(dated), "from 2026-03-01T06:00:00Z");
    }

    #[test]
    fn tables_hold_within_eighty_columns() {
        let mark = PeakMark {
            frequency_hz: 12_345.678_9,
            order: None,
            line: true,
            sd_hz: Some(1.2e-4),
            damping: Some(0.3),
            damping_sd: Some(0.02),
            level_db: Some(-3.25),
            taken_for: Some(Nature::Harmonic),
            multiple_of: Some(Multiple {
                times: 12,
                frequency_hz: 1028.8,
            }),
        };
        let candidate = Candidate {
            modes: (1..=12)
                .map(|order| Assigned {
                    order,
                    frequency_hz: 104.492 * order as f64,
                })
                .collect(),
            probability: 0.99999,
            axial_force_n: Some(Quantiles {
                q025: 1.0e6,
                q50: 1.1e6,
                q975: 1.2e6,
            }),
        };
        let text = peaks(&[mark]) + &candidates(&[candidate]);
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert!(
            text.contains("12345.67890     0.00012       30.000        -3.2  harmonic, 12 x 1028.8"),
            "{text}"
        );
        assert!(
            text.contains("> 0.9999  1100 (1000 to 1200)       1 at 104.49,"),
            "{text}"
        );
    }

    #[test]
    fn a_probability_is_never_rounded_to_certainty() {
        let said = [1.0, 0.99996, 0.996, 0.5, 0.004, 1e-6, 0.0].map(probability);
        assert_eq!(
            said,
            [
                "1.0000", "> 0.9999", "0.9960", "0.50", "0.0040", "< 0.0001", "0.0000"
            ]
        );
    }
}
