//! Length, section, material and expected force of a rod, from flags and answers.

use super::BadArguments;
use super::quantities::{self, Expected, metres, millimetres};
use super::questions::Questions;
use super::sections::{self, Profile, Section};
use crate::config::written::positive;
use clap::ValueEnum;
use std::io::BufRead;

/// Largest section of a wire \[m^2\]: 8 mm in diameter.
const WIRE_M2: f64 = 5e-5;

/// Least length over thickness of anything that vibrates like a slender beam; a tie-rod has 50 to 500.
const LEAST_SLENDERNESS: f64 = 5.0;

/// Facts of a rod from flags.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct RodFlags {
    /// Free length between the walls: 14, 14.5 m, 9500 mm, 31 ft; without a unit in metres.
    #[arg(long, value_name = "LENGTH", visible_alias = "length-m", value_parser = quantities::length)]
    pub length: Option<f64>,
    /// Section: d40 (round), 'square 40 mm', 40x60mm (width x height in the plane of vibration); without a unit millimetres from 1 on,
    /// metres up to 0.5.
    #[arg(long, value_name = "SECTION", value_parser = sections::section, conflicts_with_all = ["side_m", "diameter_m", "width_m"])]
    pub section: Option<Section>,
    /// Side of a square section in metres.
    #[arg(long, value_name = "M", value_parser = positive, conflicts_with_all = ["diameter_m", "width_m"])]
    pub side_m: Option<f64>,
    /// Diameter of a round section in metres.
    #[arg(long, value_name = "M", value_parser = positive, conflicts_with = "width_m")]
    pub diameter_m: Option<f64>,
    /// Width of a rectangle in metres, across the plane of vibration.
    #[arg(long, value_name = "M", value_parser = positive, requires = "height_m")]
    pub width_m: Option<f64>,
    /// Height of a rectangle in metres, in the plane of vibration.
    #[arg(long, value_name = "M", value_parser = positive, requires = "width_m")]
    pub height_m: Option<f64>,
    /// Material of the rod.
    #[arg(long, value_enum, ignore_case = true)]
    pub material: Option<Material>,
    /// Expected force: '150 kN' means give or take 30 %, '20..200 kN' contains it with 95 % probability.
    /// Without it every doubling from slack to yield is equally likely.
    #[arg(long, value_name = "FORCE", value_parser = quantities::force, conflicts_with = "force_n")]
    pub force: Option<Expected>,
    /// Expected force in newtons, give or take 30 %.
    #[arg(long, value_name = "N", value_parser = quantities::newtons)]
    pub force_n: Option<f64>,
}

/// Materials of rods.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Material {
    /// Wrought iron, as in historic buildings: 190 GPa give or take 10 %, 7650 kg/m3 give or take 3 %.
    #[value(aliases = ["wrought iron", "wrought-iron", "puddled iron", "ferro", "ferro battuto", "fer", "fer forg\u{e9}", "eisen", "schmiedeeisen", "hierro"])]
    Iron,
    /// Rolled steel: 206 GPa give or take 4 %, 7850 kg/m3 give or take 1 %.
    #[value(aliases = ["mild steel", "carbon steel", "structural steel", "acciaio", "acier", "stahl", "acero", "s235", "s275", "s355"])]
    Steel,
}

impl Material {
    /// Mean and coefficient of variation of Young's modulus \[Pa\] and density \[kg/m^3\].
    pub fn priors(self) -> [(f64, f64); 2] {
        match self {
            Self::Iron => [(190e9, 0.10), (7650.0, 0.03)],
            Self::Steel => [(206e9, 0.04), (7850.0, 0.01)],
        }
    }

    /// Largest stress assumed without an expected force \[Pa\]: the yield strength; for thin wire that of
    /// drawn steel.
    pub fn yield_pa(self, area_m2: f64) -> f64 {
        match self {
            Self::Iron => 300e6,
            Self::Steel if area_m2 < WIRE_M2 => 2000e6,
            Self::Steel => 500e6,
        }
    }

    fn read(text: &str) -> Result<Self, String> {
        Self::from_str(text, true).map_err(|_| {
            format!("{text:?} is neither iron nor steel; correct the priors of another material afterwards")
        })
    }

    fn said(self) -> &'static str {
        match self {
            Self::Iron => "wrought iron",
            Self::Steel => "steel",
        }
    }
}

/// Geometry, material and expected force of a rod.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rod {
    /// Free length \[m\].
    pub length_m: f64,
    /// Cross-section.
    pub profile: Profile,
    /// Material.
    pub material: Material,
    /// Expected force, if given.
    pub expected: Option<Expected>,
}

impl Rod {
    /// Rod from flags, and from answers where a flag is missing; asks for a force if `asks_force`.
    ///
    /// # Errors
    /// Flags are missing and cannot be asked for, or the answers end; the error names all of them.
    pub fn of<R: BufRead>(
        flags: &RodFlags,
        asks_force: bool,
        questions: &mut Questions<R>,
    ) -> anyhow::Result<Self> {
        let profile = flags.profile();
        if !questions.is_terminal {
            let missing = [
                ("--length", flags.length.is_none()),
                ("--section", profile.is_none()),
                ("--material", flags.material.is_none()),
            ];
            let names: Vec<&str> = missing
                .iter()
                .filter(|(_, is)| *is)
                .map(|(name, _)| *name)
                .collect();
            if let [names @ .., last] = &names[..] {
                let (list, verb) = match names {
                    [] => ((*last).to_owned(), "is"),
                    names => (format!("{} and {last}", names.join(", ")), "are"),
                };
                return Err(BadArguments(format!(
                    "{list} {verb} needed, such as --length 14 --section d40 --material iron: this is no terminal to ask on"
                ))
                .into());
            }
        }
        let length_m = match flags.length {
            Some(length_m) => length_m,
            None => {
                let question = "free length between the walls (14, 9500 mm, 31 ft)";
                let length_m = questions.ask(question, "--length", quantities::length)?;
                questions.confirm(&metres(length_m));
                length_m
            }
        };
        let profile = match profile {
            Some(Section::Known(profile)) => profile,
            Some(Section::Size(size_m)) => shape(size_m, questions)?,
            None => {
                let question = "section (d40 round, s40 square, 40x60 mm width x height, 2 in)";
                let profile = match questions.ask(question, "--section", sections::section)? {
                    Section::Known(profile) => profile,
                    Section::Size(size_m) => shape(size_m, questions)?,
                };
                questions.confirm(&profile.said());
                profile
            }
        };
        let thickness_m = profile
            .dimensions()
            .iter()
            .fold(0.0, |most: f64, (_, size)| most.max(*size));
        if length_m < LEAST_SLENDERNESS * thickness_m {
            return Err(BadArguments(format!(
                "{} long and {} thick is no tie-rod: check --length and --section, and their units",
                metres(length_m),
                millimetres(thickness_m)
            ))
            .into());
        }
        let material = match flags.material {
            Some(material) => material,
            None => {
                let material = questions.ask("material (iron, steel)", "--material", Material::read)?;
                questions.confirm(material.said());
                material
            }
        };
        let expected = match flags.force.or(flags.force_n.map(Expected::About)) {
            None if asks_force => {
                let question = "force expected (20..200 kN, 150 kN; Enter if nothing is known)";
                let expected = questions.ask_open(question, quantities::force)?;
                if let Some(expected) = expected {
                    questions.confirm(&expected.said());
                }
                expected
            }
            expected => expected,
        };
        Ok(Self {
            length_m,
            profile,
            material,
            expected,
        })
    }

    /// In words, with its units.
    pub fn said(&self) -> String {
        let force = self.expected.map_or_else(String::new, |expected| {
            format!(", expected force {}", expected.said())
        });
        format!(
            "{} long, {}, {}{force}",
            metres(self.length_m),
            self.profile.said(),
            self.material.said()
        )
    }
}

impl RodFlags {
    /// Section, from whichever flags give it.
    fn profile(&self) -> Option<Section> {
        let known = match (self.side_m, self.diameter_m, self.width_m, self.height_m) {
            (Some(side), ..) => Some(Profile::Square(side)),
            (_, Some(diameter), ..) => Some(Profile::Round(diameter)),
            (_, _, Some(width), Some(height)) => Some(Profile::Rectangle(width, height)),
            _ => None,
        };
        self.section.or(known.map(Section::Known))
    }
}

/// Section of a size that may be a diameter or a side: the two differ by a quarter in mass and by 70 % in
/// stiffness.
fn shape<R: BufRead>(size_m: f64, questions: &mut Questions<R>) -> anyhow::Result<Profile> {
    let size = millimetres(size_m);
    let question = format!("{size}: round or square");
    questions.ask(
        &question,
        &format!("--section 'd {size}' or --section 'square {size}'"),
        |answer| match answer.to_lowercase().as_str() {
            "round" | "r" | "d" => Ok(Profile::Round(size_m)),
            "square" | "s" => Ok(Profile::Square(size_m)),
            _ => Err(format!("{answer:?} is neither round nor square")),
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Typed {
        #[command(flatten)]
        flags: RodFlags,
    }

    fn asked(flags: &[&str], answers: &str) -> anyhow::Result<Rod> {
        let words = ["x"].iter().chain(flags);
        let flags = Typed::try_parse_from(words).unwrap().flags;
        let mut questions = Questions {
            answers: answers.as_bytes(),
            is_terminal: true,
        };
        Rod::of(&flags, true, &mut questions)
    }

    #[test]
    fn what_no_flag_says_is_asked_for_until_it_is_understood() {
        let rod = asked(&[], "long\n9,5\nd 0.045\nwood\niron\nnobody knows\n20..200 kN\n").unwrap();
        assert_eq!((rod.length_m, rod.profile), (9.5, Profile::Round(0.045)));
        assert_eq!(rod.material, Material::Iron);
        assert_eq!(rod.expected, Some(Expected::Between(20e3, 200e3)));
        assert_eq!(
            rod.said(),
            "9.5 m long, round, diameter 45 mm, wrought iron, expected force 20 to 200 kN with 95 % probability"
        );
        for (word, material) in [
            ("Acier", Material::Steel),
            ("WROUGHT IRON", Material::Iron),
            ("Fer forg\u{e9}", Material::Iron),
        ] {
            let rod = asked(&["--length", "3", "--section", "d40", "--material", word], "\n").unwrap();
            assert_eq!(rod.material, material, "{word}");
        }
        assert!(Typed::try_parse_from(["x", "--material", "cast iron"]).is_err());
        // A wrong answer costs the answers before it nothing, and a bare size asks for its shape.
        let rod = asked(&["--length", "3 m"], "40 mm\noval\nsquare\nSteel\n\n").unwrap();
        assert_eq!((rod.length_m, rod.profile), (3.0, Profile::Square(0.04)));
        assert_eq!((rod.material, rod.expected), (Material::Steel, None));
    }

    #[test]
    fn the_end_of_the_answers_names_the_flag() {
        let cut = |flags: &[&str], answers| asked(flags, answers).unwrap_err().to_string();
        assert!(cut(&["--length", "3"], "s70\n").contains("no answer: --material"));
        assert!(
            cut(&["--length", "3"], "70 mm\n").contains("--section 'd 70 mm' or --section 'square 70 mm'")
        );
        assert!(cut(&[], "").contains("no answer: --length"));
    }

    #[test]
    fn without_a_terminal_everything_missing_is_named_at_once() {
        let missing = |flags: &[&str]| {
            let words = ["x"].iter().chain(flags);
            let flags = Typed::try_parse_from(words).unwrap().flags;
            let mut nobody = Questions {
                answers: std::io::empty(),
                is_terminal: false,
            };
            Rod::of(&flags, true, &mut nobody).unwrap_err().to_string()
        };
        assert!(missing(&[]).starts_with("--length, --section and --material are needed"));
        assert!(missing(&["--length", "3", "--section", "d40"]).starts_with("--material is needed"));
        let thick = ["--length", "0.2", "--section", "d45", "--material", "iron"];
        assert!(missing(&thick).starts_with("0.2 m long and 45 mm thick is no tie-rod"));
        // Half a section is none.
        let said = missing(&["--length", "3", "--section", "40 mm", "--material", "iron"]);
        assert!(said.contains("--section 'd 40 mm'"), "{said}");
    }

    #[test]
    fn flags_of_one_thing_exclude_each_other() {
        for words in [
            ["--section", "d40", "--side-m", "0.04"],
            ["--force", "3 kN", "--force-n", "3000"],
        ] {
            assert!(
                Typed::try_parse_from(["x"].iter().chain(&words)).is_err(),
                "{words:?}"
            );
        }
        for (flag, text) in [
            ("--force-n", "150,000"),
            ("--force-n", "150.000"),
            ("--side-m", "0.07,1"),
            ("--width-m", "1,200"),
        ] {
            assert!(Typed::try_parse_from(["x", flag, text]).is_err(), "{flag} {text}");
        }
        assert!(Typed::try_parse_from(["x", "--force-n", "2.145e+05"]).is_ok());
        let rod = asked(
            &["--length-m", "9.5", "--width-m", "0.06", "--height-m", "0.02"],
            "iron\n\n",
        )
        .unwrap();
        assert_eq!(rod.profile, Profile::Rectangle(0.06, 0.02));
    }
}
