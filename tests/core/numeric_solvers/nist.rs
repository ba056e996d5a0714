//! The nonlinear problems of the NIST Statistical Reference Datasets: models with their derivatives, data, certified
//! parameters and residual sums of squares.

use nalgebra::{DMatrix, DVector};

/// One problem of `tests/data/nist_strd.txt`.
pub struct Problem {
    pub name: String,
    pub starts: [Vec<f64>; 2],
    pub certified: Vec<f64>,
    pub certified_rss: f64,
    pub data: Vec<(f64, f64)>,
}

fn numbers(text: &str) -> Vec<f64> {
    text.split_whitespace()
        .map(|number| number.parse().expect("a number"))
        .collect()
}

/// All problems of the file.
pub fn problems() -> Vec<Problem> {
    let text = include_str!("../../data/nist_strd.txt");
    text.split("\nproblem ").skip(1).map(problem).collect()
}

fn problem(text: &str) -> Problem {
    let field = |key: &str| {
        let line = text
            .lines()
            .find(|line| line.starts_with(key))
            .unwrap_or_else(|| panic!("no {key} in {text}"));
        numbers(&line[key.len()..])
    };
    let data = text
        .lines()
        .skip_while(|line| *line != "data")
        .skip(1)
        .map(numbers);
    Problem {
        name: text.lines().next().expect("a name").to_owned(),
        starts: [field("start1"), field("start2")],
        certified: field("certified"),
        certified_rss: field("rss")[0],
        data: data
            .filter(|pair| !pair.is_empty())
            .map(|pair| (pair[0], pair[1]))
            .collect(),
    }
}

impl Problem {
    /// Residuals y − f(x; b) and, if requested, their Jacobian −df/db.
    pub fn evaluate(
        &self,
        b: &[f64],
        residuals: &mut DVector<f64>,
        jacobian: Option<&mut DMatrix<f64>>,
    ) {
        let mut rows: Vec<Vec<f64>> = Vec::new();
        for (i, &(x, y)) in self.data.iter().enumerate() {
            let (value, derivatives) = model(&self.name, b, x);
            residuals[i] = y - value;
            rows.push(derivatives);
        }
        if let Some(jacobian) = jacobian {
            for (i, row) in rows.iter().enumerate() {
                for (j, derivative) in row.iter().enumerate() {
                    jacobian[(i, j)] = -derivative;
                }
            }
        }
    }
}

/// f(x; b) and df/db.
fn model(name: &str, b: &[f64], x: f64) -> (f64, Vec<f64>) {
    match name {
        "Misra1a" | "BoxBOD" => {
            let e = libm::exp(-b[1] * x);
            (
                b[0] * -libm::expm1(-b[1] * x),
                vec![-libm::expm1(-b[1] * x), b[0] * x * e],
            )
        }
        "Chwirut2" => {
            let denominator = b[1] + b[2] * x;
            let f = libm::exp(-b[0] * x) / denominator;
            (f, vec![-x * f, -f / denominator, -x * f / denominator])
        }
        "Lanczos3" => exponentials(
            0.0,
            &[b[0], b[2], b[4]],
            &[b[1], b[3], b[5]],
            x,
            |f, a, k| (f, vec![a[0], k[0], a[1], k[1], a[2], k[2]]),
        ),
        "MGH17" => exponentials(b[0], &[b[1], b[2]], &[b[3], b[4]], x, |f, a, k| {
            (f, vec![1.0, a[0], a[1], k[0], k[1]])
        }),
        "Hahn1" | "Thurber" => {
            let numerator = b[0] + x * (b[1] + x * (b[2] + x * b[3]));
            let denominator = 1.0 + x * (b[4] + x * (b[5] + x * b[6]));
            let f = numerator / denominator;
            let powers = [x, x * x, x * x * x];
            let above = [1.0, x, x * x, x * x * x].map(|power| power / denominator);
            (
                f,
                above
                    .into_iter()
                    .chain(powers.map(|power| -f * power / denominator))
                    .collect(),
            )
        }
        "MGH09" => {
            let (numerator, denominator) = (x * x + x * b[1], x * x + x * b[2] + b[3]);
            let f = b[0] * numerator / denominator;
            (
                f,
                vec![
                    numerator / denominator,
                    b[0] * x / denominator,
                    -f * x / denominator,
                    -f / denominator,
                ],
            )
        }
        "MGH10" => {
            let denominator = x + b[2];
            let e = libm::exp(b[1] / denominator);
            (
                b[0] * e,
                vec![
                    e,
                    b[0] * e / denominator,
                    -b[0] * e * b[1] / (denominator * denominator),
                ],
            )
        }
        "Rat43" => {
            let e = libm::exp(b[1] - b[2] * x);
            let base = 1.0 + e;
            let power = libm::pow(base, -1.0 / b[3]);
            let by_exponent = -b[0] * power * e / (base * b[3]);
            (
                b[0] * power,
                vec![
                    power,
                    by_exponent,
                    -x * by_exponent,
                    b[0] * power * libm::log1p(e) / (b[3] * b[3]),
                ],
            )
        }
        "Eckerle4" => {
            let t = (x - b[2]) / b[1];
            let e = libm::exp(-0.5 * t * t);
            let f = b[0] / b[1] * e;
            (f, vec![e / b[1], f * (t * t - 1.0) / b[1], f * t / b[1]])
        }
        "Bennett5" => {
            let base = b[1] + x;
            let power = libm::pow(base, -1.0 / b[2]);
            let f = b[0] * power;
            (
                f,
                vec![
                    power,
                    -f / (b[2] * base),
                    f * libm::log(base) / (b[2] * b[2]),
                ],
            )
        }
        unknown => panic!("no model of that name: {unknown}"),
    }
}

/// offset + Σ a·exp(−k·x), and its derivatives by a and k; `order` sorts them into the problem's order.
fn exponentials(
    offset: f64,
    a: &[f64],
    k: &[f64],
    x: f64,
    order: impl Fn(f64, Vec<f64>, Vec<f64>) -> (f64, Vec<f64>),
) -> (f64, Vec<f64>) {
    let by_a: Vec<f64> = k.iter().map(|k| libm::exp(-k * x)).collect();
    let by_k: Vec<f64> = a.iter().zip(&by_a).map(|(a, e)| -a * x * e).collect();
    let f = a.iter().zip(&by_a).fold(offset, |sum, (a, e)| sum + a * e);
    order(f, by_a, by_k)
}
