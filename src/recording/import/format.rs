//! Detects the format of a file by its first bytes, else by its ending.

use super::ImportError;
use std::path::Path;

/// Number of bytes examined.
pub(super) const LOOKED_AT: usize = 512;

/// Supported formats of other programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Format {
    /// Text tables.
    Csv,
    /// Universal file format, dataset 58.
    Uff,
    /// Sound files.
    Wav,
    /// MATLAB, versions 5 to 7.
    Mat,
    /// LabVIEW measurements as text.
    Lvm,
    /// LabVIEW measurements in binary.
    Tdms,
    /// NumPy arrays.
    Npy,
}

/// The kind of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A recording, which needs no import.
    Mcap,
    /// Another program's measurement.
    Foreign(Format),
}

impl Format {
    /// Name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Csv => "a text table",
            Self::Uff => "a universal file",
            Self::Wav => "a WAV file",
            Self::Mat => "a MATLAB file",
            Self::Lvm => "a LabVIEW measurement (text)",
            Self::Tdms => "a LabVIEW measurement (TDMS)",
            Self::Npy => "a NumPy array",
        }
    }

    /// True if `--time` can name a column or variable with the stamps.
    pub(super) fn names_stamps(self) -> bool {
        matches!(self, Self::Csv | Self::Mat | Self::Tdms)
    }

    /// Format of a file name's ending.
    fn of_ending(ending: &str) -> Option<Self> {
        match ending {
            "csv" | "txt" | "tsv" | "asc" | "dat" => Some(Self::Csv),
            "uff" | "unv" | "uf" => Some(Self::Uff),
            "wav" => Some(Self::Wav),
            "mat" => Some(Self::Mat),
            "lvm" => Some(Self::Lvm),
            "tdms" => Some(Self::Tdms),
            "npy" => Some(Self::Npy),
            _ => None,
        }
    }
}

/// The kind of a file that begins with `head`; the ending of its name decides where the bytes do not.
///
/// # Errors
/// It is of none of the formats, named where it is a known one.
pub fn kind(head: &[u8], path: &Path) -> Result<Kind, ImportError> {
    let ending = path
        .extension()
        .and_then(|ending| ending.to_str())
        .unwrap_or_default()
        .to_lowercase();
    if head.starts_with(b"\x89MCAP") {
        return Ok(Kind::Mcap);
    }
    let is_text = !head.is_empty() && !head.contains(&0) && !head.starts_with(b"\x89");
    let known = by_content(head)?;
    if ending == "mcap" {
        // Other faults of a recording are left to its own reader.
        return match known.or(is_text.then_some(Format::Csv)) {
            None => Ok(Kind::Mcap),
            Some(format) => Err(ImportError::new(format!(
                "is called .mcap and is no recording, but {}: give it its own ending, or make a recording of it with \
                 `tirante import FILE --out FILE.mcap`",
                format.name()
            ))),
        };
    }
    if let Some(known) = known {
        return Ok(Kind::Foreign(known));
    }
    let by_ending = Format::of_ending(&ending);
    match by_ending {
        Some(format) => Ok(Kind::Foreign(format)),
        None if head.is_empty() => Err(ImportError::new("is empty")),
        None if is_text => Ok(Kind::Foreign(Format::Csv)),
        None => Err(ImportError {
            is_unknown_format: true,
            ..ImportError::new(format!(
                "is of no format that is read ({FORMATS}); --input-format says which one it is"
            ))
        }),
    }
}

const FORMATS: &str = "MCAP, CSV, UFF58, WAV, MATLAB, LVM, TDMS, NPY";

fn by_content(head: &[u8]) -> Result<Option<Format>, ImportError> {
    let refuse = |what: &str| Err(ImportError::new(what));
    match head {
        [b'R', b'I', b'F', b'F', ..] if head.get(8..12) == Some(b"WAVE") => Ok(Some(Format::Wav)),
        [b'R', b'F', b'6', b'4', ..] => {
            refuse("is a WAV file of 64-bit sizes (RF64), which is not read: split it")
        }
        _ if head.starts_with(b"TDSm") || head.starts_with(b"TDSh") => Ok(Some(Format::Tdms)),
        _ if head.starts_with(b"\x93NUMPY") => Ok(Some(Format::Npy)),
        _ if head.starts_with(b"LabVIEW Measurement")
            || head.starts_with(b"\xef\xbb\xbfLabVIEW Measurement") =>
        {
            Ok(Some(Format::Lvm))
        }
        // The reader of MATLAB files refuses other versions by name.
        _ if head.starts_with(b"MATLAB ") || head.starts_with(b"\x89HDF") => Ok(Some(Format::Mat)),
        _ if matches!(head.get(124..128), Some([0, 1, b'I', b'M'] | [1, 0, b'M', b'I'])) => {
            Ok(Some(Format::Mat))
        }
        _ if head.starts_with(b"PK\x03\x04") => {
            refuse("is packed (a ZIP, a spreadsheet or .npz): unpack it, or save the sheet as CSV")
        }
        _ if head.starts_with(b"\x1f\x8b") => refuse("is packed (gzip): unpack it"),
        _ if is_universal(head) => Ok(Some(Format::Uff)),
        _ => Ok(None),
    }
}

/// True if the file begins with the delimiter of a dataset and its number.
fn is_universal(head: &[u8]) -> bool {
    let text = super::lines::text(head);
    let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
    let is_number = |line: &str| {
        let number = line.split_whitespace().next().unwrap_or_default();
        let number = number.strip_suffix('b').unwrap_or(number);
        !number.is_empty() && number.len() <= 5 && number.bytes().all(|byte| byte.is_ascii_digit())
    };
    lines.next() == Some("-1") && lines.next().is_some_and(is_number)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(head: &[u8], name: &str) -> Result<Kind, String> {
        kind(head, Path::new(name)).map_err(|error| error.to_string())
    }

    #[test]
    fn content_decides_and_the_ending_helps() {
        assert_eq!(of(b"\x89MCAP0\r\n", "a.csv"), Ok(Kind::Mcap));
        assert_eq!(of(b"", "a.mcap"), Ok(Kind::Mcap));
        assert_eq!(of(b"\0\x01\x02", "a.mcap"), Ok(Kind::Mcap));
        for (head, name) in [
            (&b"Time [s],Laser [mm]\n0,1\n"[..], "a text table"),
            (b"\x93NUMPY", "a NumPy array"),
        ] {
            let said = of(head, "a.mcap").unwrap_err();
            assert!(said.contains(name) && said.contains("tirante import"), "{said}");
        }
        assert_eq!(of(b"RIFF\0\0\0\0WAVEfmt ", "a"), Ok(Kind::Foreign(Format::Wav)));
        assert_eq!(
            of(b"MATLAB 5.0 MAT-file", "a.txt"),
            Ok(Kind::Foreign(Format::Mat))
        );
        assert_eq!(
            of(b"    -1\n    58\nwall\n", "a.txt"),
            Ok(Kind::Foreign(Format::Uff))
        );
        // One column of numbers that begins with -1 is a table.
        assert_eq!(of(b"-1\n-0.5\n0.25\n", "a.txt"), Ok(Kind::Foreign(Format::Csv)));
        assert_eq!(of(b"t,d\n0,1\n", "a.log"), Ok(Kind::Foreign(Format::Csv)));
        assert_eq!(of(b"junk", "a.wav"), Ok(Kind::Foreign(Format::Wav)));
        assert!(of(b"PK\x03\x04", "a.xlsx").unwrap_err().contains("CSV"));
        assert!(of(b"\0\x01\x02", "a.bin").unwrap_err().contains("--input-format"));
        assert!(of(b"", "a.bin").unwrap_err().contains("empty"));
    }
}
