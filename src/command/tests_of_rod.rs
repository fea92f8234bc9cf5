//! Tests of a rod as flags of `identify`, and a description of their effect on the force.

use super::BadArguments;
use crate::analysis::identify::Plan;
use crate::analysis::inference::Tested;
use crate::analysis::inference::joint::{Datum, Sampler};
use crate::analysis::rod::beam::Quantity;
use crate::analysis::rod::beam::receptance::PointMass;
use crate::analysis::rod::prior::RodPrior;
use crate::analysis::rod::query::{Queries, Query};
use crate::analysis::signal::modes::Mode;
use crate::config::Config;
use crate::config::datum::{self, Kind};

/// Score from which a datum is marked.
const MARKED: f64 = 3.0;
/// Least relative rise of the force under a load test that is reported.
const STIFF: f64 = 0.01;

/// Tests and measurements of the moment of the record.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct TestFlags {
    /// A load across the rod and the deflection there, at rest or just before its release: 300N@0.5L=1.1mm+-3%; read elsewhere:
    /// 300N@0.3L=0.9mm@0.4L. Without an error 3 % is taken. May be repeated, like all of these.
    #[arg(long, value_name = "N@PLACE=MM", visible_alias = "release")]
    pub load: Vec<String>,

    /// A mass on the rod: 20kg@0.3L with --with-mass or --mass-frequencies, or with the ratio of mode 1, 20kg@0.3L=0.953+-0.1%
    /// (another mode: mode2:20kg@0.3L=...).
    #[arg(long, value_name = "KG@PLACE")]
    pub mass: Vec<String>,

    /// Natural frequencies in Hz with the mass on the rod, as --frequencies.
    #[arg(long, value_name = "HZ,HZ,...", requires = "mass", allow_hyphen_values = true)]
    pub mass_frequencies: Option<String>,

    /// Their standard errors in Hz, as --sd.
    #[arg(
        long,
        value_name = "HZ[,HZ,...]",
        requires = "mass_frequencies",
        allow_hyphen_values = true
    )]
    pub mass_sd: Option<String>,

    /// A recording of the same rod with the mass on it.
    #[arg(
        long,
        value_name = "PATH",
        requires = "mass",
        conflicts_with = "mass_frequencies"
    )]
    pub with_mass: Option<std::path::PathBuf>,

    /// Strain amplitude over displacement amplitude in a mode, in 1/m or ue/mm: mode1:0.1L/0.4L=0.0123+-2%.
    #[arg(long, value_name = "MODE:PLACE/PLACE=RATIO")]
    pub strain: Vec<String>,

    /// Modal displacement at one place over that at another, with its sign: mode2:0.1L/0.4L=-0.62+-2%.
    #[arg(long, value_name = "MODE:PLACE/PLACE=RATIO")]
    pub shape: Vec<String>,

    /// Readings of the rod itself: side=70.1,70.4,69.9mm+-0.2mm, density=7780kg/m3+-1%, spring_left=300kNm/rad+-5%.
    #[arg(long, value_name = "QUANTITY=VALUE+-ERROR")]
    pub measured: Vec<String>,
}

/// The same, read for one rod.
pub struct Tests {
    /// Data that are complete by themselves.
    pub data: Vec<Datum>,
    /// The mass that frequencies or a record belong to.
    pub mass: Option<PointMass>,
}

/// Most of a frequency that a mass may take before its modes need windows of their own.
const MOST_ROOM: f64 = 0.2;

impl TestFlags {
    /// Data of a rod with this prior.
    ///
    /// # Errors
    /// A value that cannot be read, or is impossible, with the flag.
    pub fn read(&self, prior: &RodPrior) -> Result<Tests, BadArguments> {
        let length_m = prior
            .of(Quantity::Length)
            .map_or(f64::NAN, crate::analysis::rod::prior::Prior::centre);
        let kinds = [
            (Kind::Load, &self.load),
            (Kind::Strain, &self.strain),
            (Kind::Shape, &self.shape),
            (Kind::Measured, &self.measured),
        ];
        let mut tests = Tests {
            data: Vec::new(),
            mass: None,
        };
        let bad = |kind: Kind, why: String| BadArguments(format!("--{}: {why}", kind.key()));
        for (kind, texts) in kinds {
            for text in texts {
                tests
                    .data
                    .push(datum::datum(kind, text, length_m).map_err(|why| bad(kind, why))?);
                if kind != Kind::Measured && !text.contains("+-") && !text.contains('\u{b1}') {
                    tell!(
                        "--{} {text}: no error given, {:.0} % is taken",
                        kind.key(),
                        100.0 * datum::ASSUMED_ERROR
                    );
                }
            }
        }
        for text in &self.mass {
            if text.contains('=') {
                tests
                    .data
                    .push(datum::datum(Kind::Mass, text, length_m).map_err(|why| bad(Kind::Mass, why))?);
                continue;
            }
            let mass = datum::mass(text, length_m).map_err(|why| bad(Kind::Mass, why))?;
            if tests.mass.replace(mass).is_some() {
                return Err(bad(
                    Kind::Mass,
                    "one mass without a ratio is possible at a time".to_owned(),
                ));
            }
        }
        let has_frequencies = self.mass_frequencies.is_some() || self.with_mass.is_some();
        if tests.mass.is_some() != has_frequencies {
            let why = match has_frequencies {
                true => "the mass that the frequencies belong to is missing: --mass 20kg@0.3L",
                false => {
                    "a mass alone says nothing: --mass-frequencies, --with-mass, or the ratio, 20kg@0.3L=0.953+-0.1%"
                }
            };
            return Err(bad(Kind::Mass, why.to_owned()));
        }
        for datum in &tests.data {
            datum
                .check(prior)
                .map_err(|fault| BadArguments(fault.to_string()))?;
        }
        Ok(tests)
    }

    /// True if no test was given.
    pub fn is_empty(&self) -> bool {
        [&self.load, &self.mass, &self.strain, &self.shape, &self.measured]
            .iter()
            .all(|texts| texts.is_empty())
    }
}

impl Tests {
    /// A configuration whose labels know the rod with the mass on it: what the mass takes from each frequency at the prior's centre is
    /// allowed beside the model's discrepancy. Frequencies do not hang on it.
    pub fn with_room(&self, config: &Config, plan: &Plan) -> Config {
        let mut config = config.clone();
        let settings = plan.settings();
        let Some(mass) = self.mass else { return config };
        for rod in &mut config.rods {
            if rod.analysis.rod != settings.rod {
                continue;
            }
            for (slot, discrepancy) in rod.analysis.discrepancy.iter_mut().enumerate() {
                let query = Query::FrequencyRatio {
                    order: slot + 1,
                    mass,
                };
                let mut ratio = [1.0];
                let asked = Queries::new(*settings.prior.parameterisation(), vec![query]);
                if asked.is_some_and(|asked| asked.answers(&settings.prior.centre(), &mut ratio).is_ok()) {
                    *discrepancy = discrepancy.hypot(1.0 - ratio[0]).min(MOST_ROOM);
                }
            }
        }
        config
    }

    /// Adds the frequencies of the rod with the mass on it.
    ///
    /// # Errors
    /// An impossible mass.
    pub fn add_loaded(&mut self, modes: &[Mode], prior: &RodPrior) -> Result<(), BadArguments> {
        let mass = self.mass;
        for mode in modes {
            let datum = Datum {
                query: Query::Frequency {
                    order: mode.order,
                    mass,
                },
                value: mode.frequency_hz,
                sd: mode.sd_hz,
                gain_sd: 0.0,
            };
            datum
                .check(prior)
                .map_err(|fault| BadArguments(fault.to_string()))?;
            self.data.push(datum);
        }
        Ok(())
    }
}

/// Description of the tests' effect, in lines.
pub fn described(tested: &Tested, mean_n: f64, sd_n: f64) -> Vec<String> {
    let kn = |n: f64| 1e-3 * n;
    let digits = if sd_n < 1e3 { 2 } else { 0 };
    let mut lines = Vec::new();
    let now = format!("{:.digits$} +- {:.digits$} kN", kn(mean_n), kn(sd_n));
    match (tested.alone_mean_n, tested.alone_sd_n) {
        (Some(mean), Some(sd)) => lines.push(format!(
            "  with the tests {:.digits$} +- {:.digits$} kN becomes {now}, {:.0} % of the standard deviation",
            kn(mean),
            kn(sd),
            100.0 * sd_n / sd
        )),
        _ => lines.push(format!("  with the tests {now}")),
    }
    lines.push(match tested.sampler {
        Sampler::Table => "  sampled from the nearest draws of the prior, corrected by importance".to_owned(),
        Sampler::Sequential => format!(
            "  sampled by a sequence of {} populations, the last weighted by the errors' own density",
            tested.populations
        ),
        Sampler::Chains => "  sampled by Markov chains annealed from the prior".to_owned(),
    });
    for shape in &tested.shapes {
        let what = if shape.is_strain { "strain" } else { "amplitude" };
        lines.push(format!(
            "  sensors, mode {}: {what} at {} l over that at {} l {:.4e} +- {:.1e}",
            shape.order, shape.at, shape.reference_at, shape.ratio, shape.sd
        ));
    }
    if let Some(tolerance) = tested.tolerance_hz {
        lines.push(format!(
            "  ! no beam has these frequencies: each is taken with {tolerance:.2} Hz more, the tolerance it has without tests"
        ));
    }
    if let Some(share) = tested.stiffening.filter(|share| *share > STIFF) {
        lines.push(format!(
            "  ! a deflection that large pulls the rod tighter by up to {:.0} %, which the model leaves out: use a smaller load",
            100.0 * share
        ));
    }
    if !tested.conflicts.is_empty() {
        lines.push(String::new());
        lines.push(format!(
            "  {:<44}{:>9} {:>18} {:>5}",
            "against all the others", "measured", "predicted", "score"
        ));
    }
    for conflict in &tested.conflicts {
        let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.3e}"));
        let predicted = match (conflict.predicted, conflict.predicted_sd) {
            (Some(mean), Some(sd)) => format!("{mean:.3e} +- {sd:.1e}"),
            _ => String::new(),
        };
        let (mut name, measured) = (conflict.datum.as_str(), number(conflict.value));
        // A name that leaves no room for the numbers has a line of its own.
        if name.chars().count() + measured.len() > 52 {
            lines.push(format!("  {name}"));
            name = "";
        }
        lines.push(format!(
            "  {name:<44}{measured:>9} {predicted:>18} {:>5.1}",
            conflict.score
        ));
        if conflict.score >= MARKED {
            let hint = conflict
                .hint
                .as_deref()
                .map(|hint| format!("; it would agree {hint}"))
                .unwrap_or_default();
            lines.push(format!("  ! contradicts the others{hint}: the force is in doubt"));
        }
    }
    if tested.conflicts.len() == 2 && tested.conflicts.iter().all(|conflict| conflict.score < MARKED) {
        lines.push(
            "  one test alone: a slip within the reach of the prior does not show; a second test, of another kind, would show it"
                .to_owned(),
        );
    }
    lines
}
