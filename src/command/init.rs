//! `tirante init`: a commented configuration for one rod, from flags, questions and a recording.

use super::{BadArguments, foreign, print};
use crate::config::Config;
use crate::import::{self, How};
use crate::record::Unit;
use crate::source::contents::Content;
use anyhow::Context;
use std::fmt::Write as _;
use std::io::{self, BufRead, IsTerminal, Read, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Writes a commented configuration for one rod: the least that is needed, with priors that claim little. What no flag says is
/// asked for on a terminal; topic, field, unit and rate come from a recording, if one is given.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante init laser.mcap --out site.toml
  tirante init laser.mcap --id nave-3 --length-m 14 --side-m 0.07 --material iron --out site.toml
  tirante init --length-m 9.5 --diameter-m 0.045 --material steel --topic /rod --unit um --out site.toml

Then: tirante check site.toml; tirante identify laser.mcap --config site.toml")]
pub struct Args {
    /// A recording of the rod (MCAP), or another program's file that says its rate (CSV, UFF, WAV, MATLAB, LabVIEW).
    #[arg(value_name = "RECORDING")]
    pub recording: Option<PathBuf>,
    /// The configuration to write; one that exists is never overwritten.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// The name of the site.
    #[arg(long)]
    pub site: Option<String>,
    /// The name of the rod: letters, digits, '-', '_' and '.'.
    #[arg(long, default_value = "rod-1")]
    pub id: String,
    /// Free length between the walls in metres.
    #[arg(long, value_name = "M", value_parser = positive_flag)]
    pub length_m: Option<f64>,
    /// Side of a square section in metres.
    #[arg(long, value_name = "M", value_parser = positive_flag, conflicts_with_all = ["diameter_m", "width_m"])]
    pub side_m: Option<f64>,
    /// Diameter of a round section in metres.
    #[arg(long, value_name = "M", value_parser = positive_flag, conflicts_with = "width_m")]
    pub diameter_m: Option<f64>,
    /// Width of a rectangle in metres, across the plane of vibration.
    #[arg(long, value_name = "M", value_parser = positive_flag, requires = "height_m")]
    pub width_m: Option<f64>,
    /// Height of a rectangle in metres, in the plane of vibration.
    #[arg(long, value_name = "M", value_parser = positive_flag, requires = "width_m")]
    pub height_m: Option<f64>,
    /// What the rod is made of.
    #[arg(long, value_enum)]
    pub material: Option<Material>,
    /// The axial force expected in newtons, give or take 30 %; without it every doubling from slack to yield is as likely.
    #[arg(long, value_name = "N", value_parser = positive_flag)]
    pub force_n: Option<f64>,
    /// The topic of its displacement, velocity or acceleration.
    #[arg(long)]
    pub topic: Option<String>,
    /// The field of a message that holds the samples, if it is none of the usual ones.
    #[arg(long, value_name = "PATH")]
    pub field: Option<String>,
    /// The unit of the samples, if the recording does not say it.
    #[arg(long)]
    pub unit: Option<String>,
    /// The sample rate in Hz, of arrays only, if the recording does not say it.
    #[arg(long, value_name = "HZ", value_parser = positive_flag)]
    pub fs_hz: Option<f64>,
}

/// What a rod can be made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Material {
    /// Wrought iron, as in historic buildings: 190 GPa give or take 10 %, 7650 kg/m3 give or take 3 %.
    Iron,
    /// Rolled steel: 206 GPa give or take 4 %, 7850 kg/m3 give or take 1 %.
    Steel,
}

impl Material {
    /// Mean and coefficient of variation of Young's modulus \[Pa\] and density \[kg/m^3\].
    fn priors(self) -> [(f64, f64); 2] {
        match self {
            Self::Iron => [(190e9, 0.10), (7650.0, 0.03)],
            Self::Steel => [(206e9, 0.04), (7850.0, 0.01)],
        }
    }

    /// The largest stress thought possible where nobody expects a force \[Pa\]: the yield strength, of thin wire that of drawn steel.
    fn yield_pa(self, area_m2: f64) -> f64 {
        match self {
            Self::Iron => 300e6,
            Self::Steel if area_m2 < WIRE_M2 => 2000e6,
            Self::Steel => 500e6,
        }
    }
}

/// Sections below this are wire \[m^2\]: 8 mm in diameter.
const WIRE_M2: f64 = 5e-5;
/// The lowest stress thought possible where nobody expects a force \[Pa\]: a rod slacker than this hangs like a chain.
const SLACK_PA: f64 = 1e6;
/// The lowest force thought possible of a rod of any section \[N\].
const SLACK_N: f64 = 1e3;

/// Runs the command.
///
/// # Errors
/// Something is not said and cannot be asked for, the recording cannot be read, or the file exists or cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if args.out.exists() {
        return Err(BadArguments(format!(
            "{}: exists, and init overwrites nothing: give another --out",
            args.out.display()
        ))
        .into());
    }
    let found = match &args.recording {
        Some(path) => {
            let how = How {
                rate_hz: args.fs_hz,
                ..How::default()
            };
            import::topics(path, &how, &foreign::watch)?
        }
        None => Vec::new(),
    };
    let is_terminal = io::stdin().is_terminal() && io::stderr().is_terminal();
    let mut questions = Questions {
        answers: io::stdin().lock(),
        is_terminal,
    };
    let rod = Rod::of(args, &mut questions)?;
    let channel = Sensor::of(args, &found, &mut questions)?;
    let thermometer = found
        .iter()
        .find(|content| content.unit.is_some_and(|unit| Unit::TEMPERATURE.contains(&unit)));
    let text = written(args, &rod, &channel, thermometer);
    // What a flag or an answer made impossible is told as `check` tells it.
    Config::parse(&text, &args.out.display().to_string())?;
    save(&args.out, &text).with_context(|| format!("cannot write {}", args.out.display()))?;
    let recording = args
        .recording
        .as_ref()
        .map_or("RECORDING.mcap".to_owned(), |path| path.display().to_string());
    let out = args.out.display();
    print(format!("{out}: written. Read it, correct its priors, then\n  tirante identify {recording} --config {out}\n").as_bytes())
}

/// Writes a file that must not exist, whole or not at all.
fn save(path: &Path, text: &str) -> io::Result<()> {
    let mut file = std::fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .open(path)?;
    file.write_all(text.as_bytes())
        .and_then(|()| file.sync_all())
        .inspect_err(|_| {
            // Half a configuration is worse than none, and the fault is told either way.
            let _ = std::fs::remove_file(path);
        })
}

/// Answers to what no flag says.
struct Questions<R> {
    answers: R,
    is_terminal: bool,
}

impl<R: BufRead> Questions<R> {
    /// The answer to a question, once it can be understood; without a terminal the flag that is missing.
    fn ask<T>(
        &mut self,
        question: &str,
        flag: &str,
        understand: impl Fn(&str) -> Option<T>,
    ) -> anyhow::Result<T> {
        if !self.is_terminal {
            return Err(BadArguments(format!("{flag} is needed ({question})")).into());
        }
        loop {
            let mut err = io::stderr();
            write!(err, "{question}: ").and_then(|()| err.flush())?;
            let mut answer = String::new();
            if self.answers.by_ref().take(4096).read_line(&mut answer)? == 0 {
                return Err(BadArguments(format!("no answer: {flag} is needed ({question})")).into());
            }
            match understand(answer.trim()) {
                Some(answer) => return Ok(answer),
                None => writeln!(err, "  {:?} is not understood", answer.trim())?,
            }
        }
    }
}

fn positive_flag(text: &str) -> Result<f64, String> {
    positive(text).ok_or_else(|| "a positive number is expected".to_owned())
}

/// A positive number, decimal comma or point.
fn positive(text: &str) -> Option<f64> {
    let number: f64 = text.replace(',', ".").parse().ok()?;
    (number.is_finite() && number > 0.0).then_some(number)
}

/// The rod's geometry and material.
struct Rod {
    length_m: f64,
    section: &'static str,
    /// Keys and values of its dimensions in metres.
    dimensions: Vec<(&'static str, f64)>,
    area_m2: f64,
    material: Material,
}

impl Rod {
    fn of<R: BufRead>(args: &Args, questions: &mut Questions<R>) -> anyhow::Result<Self> {
        let length_m = match args.length_m {
            Some(length_m) => length_m,
            None => questions.ask("free length between the walls [m]", "--length-m", positive)?,
        };
        let round = |d: f64| ("round", vec![("diameter_m", d)]);
        let square = |a: f64| ("square", vec![("side_m", a)]);
        let (section, dimensions) = match (args.side_m, args.diameter_m, args.width_m, args.height_m) {
            (Some(a), ..) => square(a),
            (_, Some(d), ..) => round(d),
            (_, _, Some(w), Some(h)) => ("rectangle", vec![("width_m", w), ("height_m", h)]),
            _ => questions.ask(
                "section: side of a square, or diameter after 'd', or width x height [m]: 0.07, d 0.045, 0.06x0.02",
                "--side-m, --diameter-m or --width-m with --height-m",
                |answer| match (answer.strip_prefix('d'), answer.split_once('x')) {
                    (Some(d), _) => positive(d.trim()).map(round),
                    (_, Some((w, h))) => {
                        Some(("rectangle", vec![("width_m", positive(w.trim())?), ("height_m", positive(h.trim())?)]))
                    }
                    _ => positive(answer).map(square),
                },
            )?,
        };
        let material = match args.material {
            Some(material) => material,
            None => questions.ask("material: iron or steel", "--material", |answer| match answer {
                "iron" => Some(Material::Iron),
                "steel" => Some(Material::Steel),
                _ => None,
            })?,
        };
        let area_m2 = match dimensions[..] {
            [(_, w), (_, h)] => w * h,
            [("diameter_m", d)] => std::f64::consts::PI / 4.0 * d * d,
            [(_, a)] => a * a,
            _ => 0.0,
        };
        Ok(Self {
            length_m,
            section,
            dimensions,
            area_m2,
            material,
        })
    }
}

/// Where the samples are.
struct Sensor {
    topic: String,
    field: String,
    unit: Unit,
    fs_hz: Option<f64>,
}

impl Sensor {
    fn of<R: BufRead>(args: &Args, found: &[Content], questions: &mut Questions<R>) -> anyhow::Result<Self> {
        let is_motion = |content: &&Content| content.unit.is_none_or(|unit| Unit::MOTION.contains(&unit));
        let topics: Vec<&str> = found
            .iter()
            .filter(is_motion)
            .map(|content| content.topic.as_str())
            .collect();
        let topic = match (&args.topic, &topics[..]) {
            (Some(topic), _)
                if args.recording.is_some() && found.iter().all(|content| content.topic != *topic) =>
            {
                return Err(BadArguments(format!(
                    "--topic {topic}: the recording has {}",
                    topics.join(", ")
                ))
                .into());
            }
            (Some(topic), _) => topic.clone(),
            (None, [only]) => (*only).to_owned(),
            (None, []) if args.recording.is_some() => {
                return Err(
                    BadArguments("the recording has no channel of motion with messages".to_owned()).into(),
                );
            }
            (None, []) => questions.ask("topic of the samples", "--topic or a recording", |answer| {
                (!answer.is_empty()).then(|| answer.to_owned())
            })?,
            (None, several) => {
                let question = format!("topic of the samples, one of {}", several.join(", "));
                questions.ask(&question, "--topic", |answer| {
                    several.contains(&answer).then(|| answer.to_owned())
                })?
            }
        };
        let content = found.iter().find(|content| content.topic == topic);
        let field = match (&args.field, content.map(|content| &content.field)) {
            (Some(field), _) => field.clone(),
            (None, Some(Ok(field))) => field.clone(),
            (None, Some(Err(fault))) => {
                return Err(BadArguments(format!(
                    "--field is needed: of {topic} none of the usual fields can be read ({fault})"
                ))
                .into());
            }
            (None, None) => "value".to_owned(),
        };
        let said = content.and_then(|content| content.unit);
        let unit = match (&args.unit, said) {
            (Some(text), said) => match (Unit::as_written(text), said) {
                (None, _) => return Err(BadArguments(crate::import::unknown_unit(text)).into()),
                (Some(unit), Some(said)) if unit != said => {
                    return Err(BadArguments(format!(
                        "--unit {}: the recording says {}",
                        unit.key(),
                        said.key()
                    ))
                    .into());
                }
                (Some(unit), _) => unit,
            },
            (None, Some(said)) => said,
            (None, None) => questions.ask(
                "unit of the samples (m, mm, um, mm/s, m/s2, g ...)",
                "--unit",
                |answer| Unit::as_written(answer).filter(|unit| Unit::MOTION.contains(unit)),
            )?,
        };
        Ok(Self {
            topic,
            field,
            unit,
            fs_hz: args
                .fs_hz
                .or_else(|| content.and_then(|content| content.array_fs_hz)),
        })
    }
}

/// The configuration.
fn written(args: &Args, rod: &Rod, sensor: &Sensor, thermometer: Option<&Content>) -> String {
    let quoted = |text: &str| toml::Value::String(text.to_owned()).to_string();
    let [(modulus, modulus_cv), (density, density_cv)] = rod.material.priors();
    let force = match args.force_n {
        Some(force_n) => {
            format!("{{ mean = {force_n:?}, cv = 0.3 }}   # as expected; at best from an earlier measurement")
        }
        None => {
            let high_pa = rod.material.yield_pa(rod.area_m2);
            format!(
                "{{ low = {:.3e}, high = {:.3e}, even_in = \"logarithm\" }}   # nothing is known: from slack to {:.0} MPa",
                SLACK_N.min(SLACK_PA * rod.area_m2),
                high_pa * rod.area_m2,
                high_pa * 1e-6
            )
        }
    };
    let mut text = format!(
        "# Written by `tirante init`. `tirante check FILE` prints what holds besides; docs/configuration.md has every key.\n\n\
         [site]\nname = {}\n\n\
         [[rod]]\nid = {}\n\
         length_m = {:?}                # free length between the walls\n\
         section = \"{}\"\n\n\
         [rod.priors]                   # what is known beforehand: a number, or a distribution. Correct them: they count\n\
         axial_force_n = {force}\n\
         youngs_modulus_pa = {{ mean = {modulus:e}, cv = {modulus_cv} }}\n\
         density_kg_m3 = {{ mean = {density}, cv = {density_cv} }}\n",
        quoted(args.site.as_deref().unwrap_or("A site")),
        quoted(&args.id),
        rod.length_m,
        rod.section,
    );
    // Writing to a string cannot fail.
    for (key, value) in &rod.dimensions {
        let _ = writeln!(
            text,
            "{key} = {{ mean = {value:?}, cv = 0.02 }}   # as measured; rust and hammering included"
        );
    }
    let _ = write!(
        text,
        "spring_left_n_m = {{ fixity_low = 0, fixity_high = 0.99, ends = 2 }}    # supports, from hinged to as good as clamped\n\
         spring_right_n_m = {{ fixity_low = 0, fixity_high = 0.99, ends = 2 }}\n\n\
         [rod.channel]                  # where its samples stand in the recordings\n\
         topic = {}\nfield = {}\nunit = \"{}\"\n",
        quoted(&sensor.topic),
        quoted(&sensor.field),
        sensor.unit.key()
    );
    if let Some(fs_hz) = sensor.fs_hz {
        let _ = writeln!(text, "fs_hz = {fs_hz:?}");
    }
    match thermometer {
        Some(Content { topic, field: Ok(field), unit: Some(unit), array_fs_hz }) => {
            let _ = write!(
                text,
                "\n[rod.temperature]              # without it a warm day looks like a loss\ntopic = {}\nfield = {}\nunit = \"{}\"\n",
                quoted(topic),
                quoted(field),
                unit.key()
            );
            if let Some(fs_hz) = array_fs_hz {
                let _ = writeln!(text, "fs_hz = {fs_hz:?}");
            }
        }
        _ => text.push_str(
            "\n# [rod.temperature]            # without it a warm day looks like a loss\n# topic = \"/air\"\n# unit = \"degC\"\n",
        ),
    }
    text.push_str("\n[record]\ncut = \"auto\"                   # the motion is recognised: ambient, pulls, blows; \"free-decay\" cuts a record at each release\n");
    text.push_str("\n# [store]                      # where `replay` and `run` keep their results\n# path = \"site.db\"\n");
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Typed {
        #[command(flatten)]
        args: Args,
    }

    fn asked(flags: &[&str], answers: &str) -> anyhow::Result<(Rod, Sensor)> {
        let words = ["init", "--out", "x.toml"].iter().chain(flags);
        let args = Typed::try_parse_from(words).unwrap().args;
        let mut questions = Questions {
            answers: answers.as_bytes(),
            is_terminal: true,
        };
        Ok((
            Rod::of(&args, &mut questions)?,
            Sensor::of(&args, &[], &mut questions)?,
        ))
    }

    #[test]
    fn what_no_flag_says_is_asked_for_until_it_is_understood() {
        let (rod, sensor) = asked(&[], "long\n9,5\nd 0.045\nwood\niron\n/rod\nV\ndegC\num\n").unwrap();
        assert_eq!((rod.length_m, rod.section), (9.5, "round"));
        assert_eq!(rod.dimensions, [("diameter_m", 0.045)]);
        assert_eq!((sensor.topic.as_str(), sensor.unit), ("/rod", Unit::Micrometre));
        let (rod, _) = asked(
            &[
                "--length-m",
                "3",
                "--material",
                "steel",
                "--topic",
                "/a",
                "--unit",
                "mm",
            ],
            "0.06x0.02\n",
        )
        .unwrap();
        assert_eq!((rod.section, rod.dimensions.len()), ("rectangle", 2));
        assert!((rod.area_m2 - 1.2e-3).abs() < 1e-15);
        let cut = asked(&["--length-m", "3"], "0.07\n").err().unwrap().to_string();
        assert!(cut.contains("no answer: --material"), "{cut}");
    }

    #[test]
    fn what_is_written_is_valid_whatever_the_names() {
        for (flags, section) in [
            (vec!["--side-m", "0.07", "--material", "iron"], "square"),
            (
                vec![
                    "--diameter-m",
                    "0.045",
                    "--material",
                    "steel",
                    "--force-n",
                    "150e3",
                ],
                "round",
            ),
            (
                vec!["--width-m", "0.06", "--height-m", "0.02", "--material", "iron"],
                "rectangle",
            ),
        ] {
            let common = [
                "init",
                "--out",
                "x.toml",
                "--length-m",
                "9.5",
                "--topic",
                "/a \"b\"\\",
                "--unit",
                "g",
                "--site",
                "Sant'Anna \"x\"",
            ];
            let args = Typed::try_parse_from(common.iter().chain(&flags)).unwrap().args;
            let mut none = Questions {
                answers: io::empty(),
                is_terminal: false,
            };
            let rod = Rod::of(&args, &mut none).unwrap();
            let sensor = Sensor::of(&args, &[], &mut none).unwrap();
            let text = written(&args, &rod, &sensor, None);
            let config = Config::parse(&text, "x.toml").unwrap_or_else(|faults| panic!("{faults}\n{text}"));
            let channel = &config.rods[0].channels.displacement;
            assert_eq!(
                (channel.topic.as_str(), channel.unit),
                ("/a \"b\"\\", Unit::StandardGravity)
            );
            assert_eq!(config.site, "Sant'Anna \"x\"");
            assert_eq!(rod.section, section);
        }
    }
}
