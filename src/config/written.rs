//! Numbers as people write them. A comma may be a decimal sign, separate thousands or the entries of a list: one rule decides for
//! flags, answers and `[[rod.test]]`, and refuses what has two meanings.

/// Reads a number with decimal point or comma.
///
/// # Errors
/// It is none, or its comma may separate thousands.
pub fn decimal(digits: &str) -> Result<f64, String> {
    let none = || format!("{digits:?} is no number");
    let bare = digits.trim();
    let Some((whole, behind)) = bare.split_once(',') else {
        return bare.parse().map_err(|_| none());
    };
    if bare.contains('.') {
        return Err(format!(
            "{bare} has a point and a comma: write one decimal point, and nothing between thousands"
        ));
    }
    if behind.contains(',') {
        return Err(format!("{bare} has several commas: write it without them"));
    }
    let fraction = behind
        .find(|c: char| !c.is_ascii_digit())
        .map_or(behind, |end| &behind[..end]);
    if fraction.len() == 3 && !whole.trim_start_matches(['+', '-', '0']).is_empty() {
        return Err(format!(
            "{bare} may be {whole}{behind} or {whole}.{behind}: write it without the comma"
        ));
    }
    if whole.is_empty() || fraction.is_empty() {
        return Err(none());
    }
    format!("{whole}.{behind}").parse().map_err(|_| none())
}

/// Reads a positive number with decimal point or comma.
///
/// # Errors
/// It is none, or its comma may separate thousands.
pub fn positive(text: &str) -> Result<f64, String> {
    match decimal(text) {
        Ok(number) if number.is_finite() && number > 0.0 => Ok(number),
        Err(why) if text.contains(',') => Err(why),
        _ => Err("a positive number is expected".to_owned()),
    }
}

/// Splits the entries of a list of numbers: at semicolons, else at commas. A comma between two digits separates entries only where it
/// cannot be a decimal comma, nor one between thousands.
///
/// # Errors
/// A comma may be either.
pub fn list(text: &str) -> Result<Vec<&str>, String> {
    if text.contains(';') {
        return Ok(text.split(';').map(str::trim).collect());
    }
    let bytes = text.as_bytes();
    let is_digit = |place: Option<usize>| {
        place
            .and_then(|place| bytes.get(place))
            .is_some_and(u8::is_ascii_digit)
    };
    let commas: Vec<usize> = text.match_indices(',').map(|(place, _)| place).collect();
    let is_between = |place: &usize| is_digit(place.checked_sub(1)) && is_digit(place.checked_add(1));
    let (between, certain): (Vec<usize>, Vec<usize>) = commas.iter().partition(|place| is_between(place));
    let parts_at = |places: &[usize]| {
        let mut parts = Vec::new();
        let mut begin = 0;
        for &place in places {
            parts.push(text[begin..place].trim());
            begin = place + 1;
        }
        parts.push(text[begin..].trim());
        parts
    };
    if between.is_empty() {
        return Ok(parts_at(&certain));
    }
    let unclear = |other: &str| {
        Err(format!(
            "a comma of {:?} may be a decimal comma or stand between two numbers: write decimal points, or ';' between the numbers{other}",
            text.trim()
        ))
    };
    if !certain.is_empty() {
        // Decimal commas beside certain separators: in every entry, or in none.
        let parts = parts_at(&certain);
        let with_comma = parts.iter().filter(|part| part.contains(',')).count();
        let is_pointed = text.contains('.');
        return match (with_comma == parts.len(), is_pointed) {
            (true, false) => Ok(parts),
            // Points are the decimal signs, so that every comma separates.
            (_, true) => Ok(parts_at(&commas)),
            _ => unclear(""),
        };
    }
    let parts = parts_at(&between);
    let fraction = |part: &str| -> Option<usize> {
        let (_, behind) = part.split_once('.')?;
        Some(behind.bytes().take_while(u8::is_ascii_digit).count())
    };
    let leading = |part: &str| part.bytes().take_while(u8::is_ascii_digit).count();
    let pointed = parts.iter().filter(|part| part.contains('.')).count();
    let is_separated = match pointed {
        // 70,1 and 70,71,69,70: as decimal commas one and two numbers. 1,200,300: one number with its thousands.
        0 => parts.len() % 2 == 1 && parts[1..].iter().any(|part| leading(part) != 3),
        // 1.250,5 and 1,250.5: one number with its thousands.
        1 if parts.len() == 2 => {
            !(fraction(parts[0]) == Some(3) || (fraction(parts[1]).is_some() && leading(parts[1]) == 3))
        }
        _ => true,
    };
    match is_separated {
        true => Ok(parts),
        false => unclear(&format!(", such as '{}'", parts.join("; "))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_comma_is_a_decimal_comma_unless_it_may_separate_thousands() {
        for (text, value) in [
            ("9,5", 9.5),
            ("9.5", 9.5),
            ("0,950", 0.95),
            ("51200", 51_200.0),
            ("1,5e3", 1500.0),
            ("-0,62", -0.62),
            ("1,2345", 1.2345),
        ] {
            assert_eq!(decimal(text), Ok(value), "{text}");
        }
        for (text, reason) in [
            ("51,200", "51200 or 51.200"),
            ("150,000", "150000 or 150.000"),
            ("1,200e3", "1200e3 or 1.200e3"),
            ("-1,250", "-1250 or -1.250"),
            ("1.250,5", "a point and a comma"),
            ("1,250.5", "a point and a comma"),
            ("1,200,300", "several commas"),
            ("1,", "no number"),
            (",5", "no number"),
            ("", "no number"),
        ] {
            let said = decimal(text).unwrap_err();
            assert!(said.contains(reason), "{text}: {said}");
        }
        assert_eq!(positive("9,5"), Ok(9.5));
        for text in ["51,200", "-1,5", "0", "nan", "inf", "x"] {
            assert!(positive(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_comma_of_a_list_separates_where_it_can_do_nothing_else() {
        for (text, parts) in [
            ("70.1,70.4,69.9mm", &["70.1", "70.4", "69.9mm"][..]),
            ("70.1,70,69.9", &["70.1", "70", "69.9"]),
            ("4.492,9.288", &["4.492", "9.288"]),
            ("70.1,70mm", &["70.1", "70mm"]),
            ("70,71,69mm", &["70", "71", "69mm"]),
            ("70mm,71mm", &["70mm", "71mm"]),
            ("70,1; 70,4mm", &["70,1", "70,4mm"]),
            ("70;71mm", &["70", "71mm"]),
            ("70,1, 70,4, 69,9mm", &["70,1", "70,4", "69,9mm"]),
            ("70,1mm,70,4mm", &["70,1mm", "70,4mm"]),
            ("70.1,70.4, 69.9mm", &["70.1", "70.4", "69.9mm"]),
            ("4.5,-,13.2", &["4.5", "-", "13.2"]),
            ("70.1mm", &["70.1mm"]),
        ] {
            assert_eq!(list(text).as_deref(), Ok(parts), "{text}");
        }
        for text in [
            "70,1mm",
            "7,85g/cm3",
            "70,71",
            "9,4",
            "70,71,69,70mm",
            "1,200,300",
            "1.250,5mm",
            "1,250.5mm",
            "70,71, 69mm",
        ] {
            let said = list(text).unwrap_err();
            assert!(said.contains("decimal comma"), "{text}: {said}");
        }
    }
}
