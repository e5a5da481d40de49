//! A report as text.

use std::fmt;

use super::metrics::Scores;
use super::report::Report;

/// Width of the columns of numbers.
const WIDTH: usize = 9;

impl fmt::Display for Report {
    /// Two tables, published and corrected; lengths and squared lengths times 1000.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "published: each cloud in its own unit sphere; CD, HD squared; P2F in the mesh's units; x 1e-3"
        )?;
        self.block(f, &["CD", "HD", "P2F"], |s| {
            let s = s.published;
            vec![thousandths(Some(s.chamfer)), thousandths(Some(s.hausdorff)), thousandths(s.point_to_face)]
        })?;
        writeln!(
            f,
            "\ncorrected: the reference's unit sphere for all; only CD squared; x 1e-3, but F (share within {}) \
             and CV (of spacing)",
            self.settings.tolerance
        )?;
        self.block(f, &["CD", "H", "H95", "to surf.", "from s.", "F", "CV"], |s| {
            let s = s.corrected;
            vec![
                thousandths(Some(s.chamfer)),
                thousandths(Some(s.hausdorff)),
                thousandths(Some(s.hausdorff_95)),
                thousandths(s.to_surface),
                thousandths(Some(s.from_surface)),
                format!("{:.3}", s.f_score),
                format!("{:.3}", s.spacing_variation),
            ]
        })
    }
}

impl Report {
    /// A table: a line a row, then a line a mean.
    fn block(
        &self,
        f: &mut fmt::Formatter<'_>,
        names: &[&str],
        values: impl Fn(&Scores) -> Vec<String>,
    ) -> fmt::Result {
        let shape_width = self.rows.iter().map(|r| r.shape.chars().count()).max().unwrap_or(0).max(10);
        write!(f, "{:shape_width$}  {:10} {:>8}", "shape", "method", "points")?;
        for name in names {
            write!(f, " {name:>WIDTH$}")?;
        }
        writeln!(f)?;
        let rows = self.rows.iter().map(|r| (r.shape.clone(), r.method, r.points.to_string(), &r.scores));
        let means =
            self.means.iter().map(|m| (format!("mean of {}", m.shapes), m.method, String::new(), &m.scores));
        for (shape, method, points, scores) in rows.chain(means) {
            write!(f, "{shape:shape_width$}  {:10} {points:>8}", method.name())?;
            for value in values(scores) {
                write!(f, " {value:>WIDTH$}")?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

fn thousandths(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{:.3}", 1e3 * v))
}

#[cfg(test)]
mod tests {
    use super::super::report::{Method, Row, Settings};
    use super::super::score;
    use super::*;

    #[test]
    fn tables_have_a_line_a_row_and_a_mean_a_method() {
        let line = |xs: &[f64]| xs.iter().map(|x| [*x, 0.0, 0.0]).collect::<Vec<_>>();
        let reference = line(&[-1.0, 0.0, 1.0]);
        let row = |shape: &str, method, xs: &[f64]| Row {
            shape: shape.into(),
            method,
            points_in: None,
            points: xs.len(),
            reference_points: 3,
            scores: score(&line(xs), &reference, None, 0.01).expect("scores"),
        };
        let rows = vec![
            row("a", Method::Prediction, &[-1.0, -0.5, 0.0, 0.5, 1.0]),
            row("a", Method::Repeat, &[-1.0, 0.0, 1.0]),
            row("b", Method::Prediction, &[-1.0, 0.0, 1.0]),
        ];
        let settings = Settings {
            version: "0".into(),
            predictions: None,
            inputs: None,
            references: "r".into(),
            meshes: None,
            cascade: None,
            seed: 0,
            tolerance: 0.01,
        };
        let report = Report::new(settings, rows);
        assert_eq!(report.means.len(), 2);
        assert_eq!((report.means[0].method, report.means[0].shapes), (Method::Prediction, 2));
        assert!((report.means[0].scores.published.chamfer - 0.05).abs() < 1e-12);

        let text = report.to_string();
        let lines: Vec<Vec<&str>> = text.lines().map(|l| l.split_whitespace().collect()).collect();
        assert_eq!(lines[1], ["shape", "method", "points", "CD", "HD", "P2F"]);
        assert_eq!(lines[2], ["a", "prediction", "5", "100.000", "250.000", "-"]);
        assert_eq!(lines[5], ["mean", "of", "2", "prediction", "50.000", "125.000", "-"]);
        let json = serde_json::to_value(&report).expect("JSON");
        assert_eq!(json["rows"][0]["published"]["hausdorff"], 0.25);
        assert_eq!(json["rows"][1]["method"], "repeat");
        assert_eq!(json["means"][0]["published"]["point_to_face"], serde_json::Value::Null);
        assert_eq!(json["settings"]["tolerance"], 0.01);
    }
}
