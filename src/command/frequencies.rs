//! `tirante frequencies`: natural frequencies of a given rod, by every forward model side by side.

use crate::analysis::rod::beam::forward::{ForwardModel, MAX_MODES};
use crate::analysis::rod::beam::{
    Exact, FiniteElements, Parameterisation, Quantity, Section, finite_elements,
};
use crate::analysis::rod::emulator::ReducedModel;
use crate::analysis::rod::prior::RodPrior;
use crate::command::which_store::Output;
use crate::site::emulator_cache::Cache;
use std::io::Write;
use std::process::ExitCode;

/// Compute natural frequencies of a rod by every forward model.
///
/// Quantities that are not given are those of the paper's rod in Todi, and are named on standard error. The paper's
/// polynomial chaos is trained for that rod's prior and gives results only inside it.
#[derive(Debug, Clone, clap::Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:
  tirante frequencies --length 9.5 --section round --diameter 0.04 \\
      --axial-force 60e3 --spring-left 0 --spring-right 5e4"
)]
pub struct Args {
    /// Cross-section.
    #[arg(long, value_enum, default_value_t = Shape::Square)]
    pub section: Shape,
    /// Axial force in N, tension positive.
    #[arg(long, value_name = "N")]
    pub axial_force: Option<f64>,
    /// Young's modulus in Pa.
    #[arg(long, value_name = "PA")]
    pub youngs_modulus: Option<f64>,
    /// Mass density in kg/m^3.
    #[arg(long, value_name = "KG/M3")]
    pub density: Option<f64>,
    /// Side of a square section in m.
    #[arg(long, value_name = "M")]
    pub side: Option<f64>,
    /// Diameter of a round section in m.
    #[arg(long, value_name = "M")]
    pub diameter: Option<f64>,
    /// Width of a rectangle in m, across the plane of vibration.
    #[arg(long, value_name = "M")]
    pub width: Option<f64>,
    /// Height of a rectangle in m, in the plane of vibration.
    #[arg(long, value_name = "M")]
    pub height: Option<f64>,
    /// Flexural rigidity EI in N m^2, for the section `direct`.
    #[arg(long, value_name = "N*M2")]
    pub flexural_rigidity: Option<f64>,
    /// Mass per length in kg/m, for the section `direct`.
    #[arg(long, value_name = "KG/M")]
    pub mass_per_length: Option<f64>,
    /// Rotational stiffness of the left support in N m/rad; 0 is a hinge, inf a clamp.
    #[arg(long, value_name = "N*M")]
    pub spring_left: Option<f64>,
    /// Rotational stiffness of the right support in N m/rad.
    #[arg(long, value_name = "N*M")]
    pub spring_right: Option<f64>,
    /// Free length in m.
    #[arg(long, value_name = "M")]
    pub length: Option<f64>,
    /// Number of modes, 1 to 5.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=MAX_MODES as i64))]
    pub modes: u8,
    /// Number of finite elements.
    #[arg(long, default_value_t = finite_elements::ELEMENTS as u16, value_parser = clap::value_parser!(u16).range(8..=2000))]
    pub elements: u16,
    /// Total order of the paper's chaos, 1 to 8.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=8))]
    pub order: u8,
    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,
}

/// Cross-section of the rod.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Shape {
    /// Square of side `--side`.
    Square,
    /// Solid circle of `--diameter`.
    Round,
    /// `--width` by `--height`.
    Rectangle,
    /// `--flexural-rigidity` and `--mass-per-length`.
    Direct,
}

impl From<Shape> for Section {
    fn from(shape: Shape) -> Self {
        match shape {
            Shape::Square => Self::Square,
            Shape::Round => Self::Round,
            Shape::Rectangle => Self::Rectangle,
            Shape::Direct => Self::Direct,
        }
    }
}

/// Answer of one model, or its error.
struct Answer {
    model: &'static str,
    result: Result<(Vec<f64>, Vec<f64>), String>,
}

/// Prints the table, or a line of JSON per model. Exit code 2: the arguments describe no rod.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let parameterisation = Parameterisation::new(args.section.into());
    let theta = match args.theta(&parameterisation) {
        Ok((theta, defaults)) => {
            if !defaults.is_empty() {
                tell!("not given, taken from the paper's rod: {}", defaults.join(", "));
            }
            theta
        }
        Err(reason) => {
            tell!("tirante frequencies: {reason}");
            return Ok(ExitCode::from(super::USAGE));
        }
    };
    if let Err(outside) = parameterisation.beam(&theta).check("beam") {
        tell!("tirante frequencies: {outside}");
        return Ok(ExitCode::from(super::USAGE));
    }

    let modes = usize::from(args.modes);
    let ask = |model: &dyn ForwardModel| {
        let (mut frequencies, mut slopes) = (vec![0.0; modes], vec![0.0; modes]);
        let asked = model.frequencies(&theta, &mut frequencies);
        let asked = asked.and_then(|()| model.log_slopes(&theta, &mut slopes));
        Answer {
            model: model.name(),
            result: asked.map(|()| (frequencies, slopes)).map_err(|e| e.to_string()),
        }
    };
    let mut answers = vec![
        ask(&Exact::new(parameterisation)),
        ask(&FiniteElements::new(parameterisation, usize::from(args.elements))),
        ask(&ReducedModel::new(parameterisation)),
    ];
    let paper = RodPrior::todi();
    answers.push(if parameterisation == *paper.parameterisation() {
        let (pce, _) = super::emulator::fitted_pce(&Cache::of_user(), &paper, usize::from(args.order))?;
        ask(&pce)
    } else {
        Answer {
            model: "pce",
            result: Err("it is trained for the paper's square rod".to_owned()),
        }
    });

    let mut out = Vec::new();
    if args.output.is_json() {
        write_json(&mut out, &parameterisation, &theta, &answers)?;
    } else {
        write_table(&mut out, &answers, modes)?;
    }
    super::print(&out)
}

impl Args {
    /// Parameter vector and the names of the entries taken from the paper, or the fault.
    fn theta(&self, parameterisation: &Parameterisation) -> Result<(Vec<f64>, Vec<String>), String> {
        let paper = RodPrior::todi();
        let given = [
            (Quantity::AxialForce, self.axial_force, "--axial-force"),
            (Quantity::YoungsModulus, self.youngs_modulus, "--youngs-modulus"),
            (Quantity::Density, self.density, "--density"),
            (Quantity::Side, self.side, "--side"),
            (Quantity::Diameter, self.diameter, "--diameter"),
            (Quantity::Width, self.width, "--width"),
            (Quantity::Height, self.height, "--height"),
            (
                Quantity::FlexuralRigidity,
                self.flexural_rigidity,
                "--flexural-rigidity",
            ),
            (Quantity::MassPerLength, self.mass_per_length, "--mass-per-length"),
            (Quantity::SpringLeft, self.spring_left, "--spring-left"),
            (Quantity::SpringRight, self.spring_right, "--spring-right"),
            (Quantity::Length, self.length, "--length"),
        ];
        let section = parameterisation.section().key();
        let foreign = given
            .iter()
            .find(|(q, value, _)| value.is_some() && parameterisation.index(*q).is_none());
        if let Some((_, _, flag)) = foreign {
            return Err(format!("{flag} does not belong to the section {section}"));
        }
        let mut defaults = Vec::new();
        let mut theta = Vec::new();
        for &quantity in parameterisation.quantities() {
            let Some((_, value, flag)) = given.iter().find(|(q, _, _)| *q == quantity) else {
                continue;
            };
            theta.push(match (value, paper.of(quantity)) {
                (Some(value), _) => *value,
                (None, Some(prior)) => {
                    defaults.push(format!("{} {}", quantity.key(), prior.centre()));
                    prior.centre()
                }
                (None, None) => return Err(format!("the section {section} needs {flag}")),
            });
        }
        Ok((theta, defaults))
    }
}

fn write_table(out: &mut impl Write, answers: &[Answer], modes: usize) -> std::io::Result<()> {
    let mut answered = answers
        .iter()
        .filter_map(|a| Some((a.model, a.result.as_ref().ok()?)));
    if let Some((_, (exact, slopes))) = answered.next() {
        let rest: Vec<_> = answered.collect();
        if !rest.is_empty() {
            writeln!(out, "Other models: difference from exact in Hz.")?;
        }
        write!(out, "mode   exact [Hz]")?;
        for (model, _) in &rest {
            write!(out, "  {model:>9}")?;
        }
        writeln!(out, "   d ln f / d ln N")?;
        for mode in 0..modes {
            write!(out, "{:>4}  {:>11.6}", mode + 1, exact[mode])?;
            for (model, (frequencies, _)) in &rest {
                let width = model.len().max(9);
                write!(out, "  {:>width$.2e}", frequencies[mode] - exact[mode])?;
            }
            writeln!(out, "  {:>16.4}", slopes[mode])?;
        }
    }
    for answer in answers {
        if let Err(reason) = &answer.result {
            tell!("{} has no answer: {reason}", answer.model);
        }
    }
    Ok(())
}

fn write_json(
    out: &mut impl Write,
    parameterisation: &Parameterisation,
    theta: &[f64],
    answers: &[Answer],
) -> anyhow::Result<()> {
    let quantities = parameterisation.quantities().iter().zip(theta);
    // JSON has no infinity: a clamp is null.
    let rod: serde_json::Map<_, _> = quantities
        .map(|(q, &v)| (q.key().to_owned(), serde_json::json!(v)))
        .collect();
    for answer in answers {
        let line = match &answer.result {
            Ok((frequencies, slopes)) => {
                let modes: Vec<_> = (frequencies.iter().zip(slopes).enumerate())
                    .map(|(i, (f, s))| serde_json::json!({"order": i + 1, "frequency_hz": f, "log_slope": s}))
                    .collect();
                serde_json::json!({"model": answer.model, "section": parameterisation.section(), "rod": rod,
                                   "modes": modes, "outside": null})
            }
            Err(reason) => {
                serde_json::json!({"model": answer.model, "section": parameterisation.section(), "rod": rod,
                                   "modes": [], "outside": reason})
            }
        };
        writeln!(out, "{}", serde_json::to_string(&line)?)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    fn theta(line: &str) -> Result<(Vec<f64>, Vec<String>), String> {
        let args = Line::parse_from(std::iter::once("frequencies").chain(line.split_whitespace())).args;
        args.theta(&Parameterisation::new(args.section.into()))
    }

    #[test]
    fn what_is_not_given_is_the_papers_and_is_named() {
        let (values, defaults) = theta("--axial-force 5e5 --length 9").unwrap();
        assert_eq!(values, [5e5, 2e11, 7500.0, 0.07, 4e5, 4e5, 9.0]);
        assert_eq!(defaults.len(), 5);
        assert!(defaults.contains(&"side_m 0.07".to_owned()), "{defaults:?}");
    }

    #[test]
    fn sections_need_and_refuse_their_own_flags() {
        assert_eq!(
            theta("--section round").unwrap_err(),
            "the section round needs --diameter"
        );
        let error = theta("--section round --diameter 0.04 --side 0.03").unwrap_err();
        assert_eq!(error, "--side does not belong to the section round");
        assert!(theta("--section direct --flexural-rigidity 4e5 --mass-per-length 37").is_ok());
    }
}
