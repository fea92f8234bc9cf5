//! Long series thinned to one value per pixel column, so that a decade stays small and no extreme is lost.

/// One value of a series with its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Time \[Unix s\].
    pub time: f64,
    /// Value of the series.
    pub value: f64,
    /// Its 95 % interval; both ends the value itself where there is none.
    pub interval: (f64, f64),
}

/// Content of a column of the drawing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Column {
    /// Mean time of its points \[Unix s\].
    pub time: f64,
    /// Mean value.
    pub mean: f64,
    /// Mean of the intervals' ends.
    pub interval: (f64, f64),
    /// Smallest and largest value.
    pub extremes: (f64, f64),
    /// Number of points.
    pub count: usize,
}

/// The points, ascending in time, gathered into at most `columns` columns of equal width over `span`; columns without
/// points are left out. A series that is short enough stays as it is.
pub fn columns(points: &[Point], span: (f64, f64), columns: usize) -> Vec<Column> {
    let width = (span.1 - span.0) / columns.max(1) as f64;
    let few = points.len() <= columns || width.is_nan() || width <= 0.0;
    let mut result: Vec<(i64, Column)> = Vec::new();
    for (i, point) in points.iter().enumerate() {
        let at = if few {
            i as i64
        } else {
            ((point.time - span.0) / width) as i64
        };
        match result.last_mut() {
            Some((last, column)) if *last == at => {
                column.time += point.time;
                column.mean += point.value;
                column.interval.0 += point.interval.0;
                column.interval.1 += point.interval.1;
                column.extremes.0 = column.extremes.0.min(point.value);
                column.extremes.1 = column.extremes.1.max(point.value);
                column.count += 1;
            }
            _ => result.push((
                at,
                Column {
                    time: point.time,
                    mean: point.value,
                    interval: point.interval,
                    extremes: (point.value, point.value),
                    count: 1,
                },
            )),
        }
    }
    result
        .into_iter()
        .map(|(_, sum)| {
            let n = sum.count as f64;
            Column {
                time: sum.time / n,
                mean: sum.mean / n,
                interval: (sum.interval.0 / n, sum.interval.1 / n),
                ..sum
            }
        })
        .collect()
}

/// Splits the columns where neighbours lie much further apart than usual: a line must not be drawn across a
/// gap.
pub fn without_gaps(columns: &[Column]) -> impl Iterator<Item = &[Column]> {
    let mut distances: Vec<f64> = columns
        .windows(2)
        .map(|pair| pair[1].time - pair[0].time)
        .collect();
    distances.sort_by(f64::total_cmp);
    let usual = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
    columns.chunk_by(move |a, b| b.time - a.time <= 5.0 * usual)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(n: usize) -> Vec<Point> {
        (0..n)
            .map(|i| Point {
                time: i as f64,
                value: if i == 5000 { 9.0 } else { (i % 2) as f64 },
                interval: (-1.0, 2.0),
            })
            .collect()
    }

    #[test]
    fn extremes_survive() {
        let thinned = columns(&series(10_000), (0.0, 10_000.0), 500);
        assert_eq!(thinned.len(), 500);
        assert_eq!(thinned.iter().map(|c| c.count).sum::<usize>(), 10_000);
        assert_eq!(thinned.iter().map(|c| c.extremes.1).fold(0.0, f64::max), 9.0);
        assert!((thinned[0].mean - 0.5).abs() < 1e-12 && thinned[0].interval == (-1.0, 2.0));
        assert_eq!(columns(&series(100), (0.0, 100.0), 500).len(), 100);
    }

    #[test]
    fn lines_end_at_silence() {
        let mut points = series(100);
        for point in &mut points[50..] {
            point.time += 30.0;
        }
        let all = columns(&points, (0.0, 130.0), 500);
        let parts: Vec<usize> = without_gaps(&all).map(<[Column]>::len).collect();
        assert_eq!(parts, [50, 50]);
        assert_eq!(without_gaps(&[]).count(), 0);
    }
}
