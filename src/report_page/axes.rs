//! Ranges, tick values and axes of a figure.

use super::text;
use maud::{Markup, html};

/// Width of every figure, in SVG units. On paper the figure is scaled to the page.
pub const WIDTH: f64 = 680.0;
const LEFT: f64 = 52.0;
const RIGHT: f64 = 8.0;
const TOP: f64 = 18.0;
const BOTTOM: f64 = 34.0;

/// Range of values along one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    pub min: f64,
    pub max: f64,
    pub log: bool,
}

impl Range {
    /// A range from zero to the largest value.
    pub fn from_zero(values: impl Iterator<Item = f64>) -> Self {
        let max = values.filter(|v| v.is_finite()).fold(0.0, f64::max);
        Self {
            min: 0.0,
            max: if max > 0.0 { 1.04 * max } else { 1.0 },
            log: false,
        }
    }

    /// A logarithmic range of all positive values, with a margin at both ends.
    pub fn logarithmic(values: impl Iterator<Item = f64>) -> Self {
        let (min, max) = values
            .filter(|v| v.is_finite() && *v > 0.0)
            .fold((f64::INFINITY, 0.0), |(a, b), v| (v.min(a), v.max(b)));
        if max == 0.0 {
            return Self {
                min: 0.1,
                max: 1.0,
                log: true,
            };
        }
        Self {
            min: min / 1.5,
            max: (max * 1.3).max(min * 4.0),
            log: true,
        }
    }

    /// A range of all values, with a small margin at both ends.
    pub fn around(values: impl Iterator<Item = f64>) -> Self {
        let (min, max) = values
            .filter(|v| v.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
                (v.min(a), v.max(b))
            });
        if min > max {
            return Self {
                min: 0.0,
                max: 1.0,
                log: false,
            };
        }
        let room = 0.03
            * if max > min {
                max - min
            } else {
                min.abs().max(1.0)
            };
        Self {
            min: min - room,
            max: max + room,
            log: false,
        }
    }

    /// Relative position of a value in the range, 0 to 1. In a logarithmic range, a value beyond an end is moved to that end.
    pub fn share(&self, value: f64) -> f64 {
        if self.log {
            let (low, high) = (self.min.log10(), self.max.log10());
            return (value.max(self.min).min(self.max).log10() - low) / (high - low);
        }
        (value - self.min) / (self.max - self.min)
    }

    /// About `count` tick values, which are round numbers.
    pub fn ticks(&self, count: usize) -> Vec<f64> {
        if self.log {
            self.powers(count)
        } else {
            self.steps(count)
        }
    }

    fn steps(&self, count: usize) -> Vec<f64> {
        let raw = (self.max - self.min) / count.max(1) as f64;
        let base = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .into_iter()
            .map(|m| m * base)
            .find(|step| *step >= 0.8 * raw)
            .unwrap_or(10.0 * base);
        let (first, last) = (
            (self.min / step - 1e-9).ceil() as i64,
            (self.max / step + 1e-9).floor() as i64,
        );
        (first..=last)
            .take(4 * count + 4)
            .map(|i| i as f64 * step)
            .collect()
    }

    fn powers(&self, count: usize) -> Vec<f64> {
        let (low, high) = (
            self.min.log10().ceil() as i32,
            self.max.log10().floor() as i32,
        );
        if low >= high {
            let steps =
                (low - 1..=high + 1).flat_map(|e| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(e)));
            return steps
                .filter(|v| (self.min..=self.max).contains(v))
                .collect();
        }
        let every = ((high - low + 1) as usize).div_ceil(count.max(1)).max(1);
        (low..=high)
            .rev()
            .step_by(every)
            .map(|e| 10f64.powi(e))
            .collect()
    }

    fn label(&self, value: f64) -> String {
        if self.log && !(1e-2..1e4).contains(&value) {
            return text::power_of_ten(value.log10().round() as i32);
        }
        let text = text::number(if value.abs() < 1e-9 * (self.max - self.min) {
            0.0
        } else {
            value
        });
        if text.contains('.') && !text.contains('·') {
            text.trim_end_matches('0').trim_end_matches('.').into()
        } else {
            text
        }
    }
}

/// A drawing area with two ranges.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    pub x: Range,
    pub y: Range,
    pub width: f64,
    pub height: f64,
}

/// Labels of the axes.
pub struct Labels<'a> {
    pub x: &'a str,
    pub y: &'a str,
    /// Whether the x axis has ticks. False if positions along x have no numeric value.
    pub x_ticks: bool,
}

impl Frame {
    pub fn left(&self) -> f64 {
        LEFT
    }

    pub fn right(&self) -> f64 {
        self.width - RIGHT
    }

    pub fn top(&self) -> f64 {
        TOP
    }

    pub fn bottom(&self) -> f64 {
        self.height - BOTTOM
    }

    /// Horizontal position of a value.
    pub fn px(&self, value: f64) -> f64 {
        LEFT + self.x.share(value) * (self.right() - LEFT)
    }

    /// Vertical position of a value.
    pub fn py(&self, value: f64) -> f64 {
        self.bottom() - self.y.share(value) * (self.bottom() - TOP)
    }

    /// Both axes with grid lines.
    pub fn axes(&self, labels: &Labels<'_>) -> Markup {
        let (left, right, bottom) = (LEFT, self.right(), self.bottom());
        let x_ticks = if labels.x_ticks {
            self.x.ticks(((right - left) / 80.0) as usize)
        } else {
            vec![]
        };
        html! {
            @for v in self.y.ticks(((bottom - TOP) / 32.0) as usize) {
                line.grid x1=(left) x2=(right) y1=(place(self.py(v))) y2=(place(self.py(v))) {}
                text x=(left - 6.0) y=(place(self.py(v) + 4.0)) text-anchor="end" { (self.y.label(v)) }
            }
            @for v in x_ticks {
                line.axis x1=(place(self.px(v))) x2=(place(self.px(v))) y1=(bottom) y2=(bottom + 4.0) {}
                text x=(place(self.px(v))) y=(bottom + 16.0) text-anchor=(if self.px(v) > right - 12.0 { "end" } else { "middle" }) { (self.x.label(v)) }
            }
            line.axis x1=(left) x2=(right) y1=(bottom) y2=(bottom) {}
            text x="4" y="11" { (labels.y) }
            text x=(right) y=(self.height - 4.0) text-anchor="end" { (labels.x) }
        }
    }
}

/// An SVG coordinate as text, with as many digits as are needed in print.
pub fn place(value: f64) -> String {
    format!("{value:.1}")
}

#[cfg(test)]
mod tests {
    use super::Range;

    #[test]
    fn ticks_are_round_and_inside() {
        let linear = Range {
            min: 0.0,
            max: 3.3,
            log: false,
        };
        assert_eq!(linear.ticks(4), [0.0, 1.0, 2.0, 3.0]);
        let decades = Range {
            min: 2e-12,
            max: 800.0,
            log: true,
        };
        assert_eq!(decades.ticks(5), [1e2, 1e-1, 1e-4, 1e-7, 1e-10]);
        let narrow = Range {
            min: 0.9,
            max: 6.0,
            log: true,
        };
        assert_eq!(narrow.ticks(5), [1.0, 2.0, 5.0]);
    }

    #[test]
    fn every_range_has_a_width() {
        for range in [
            Range::from_zero(std::iter::empty()),
            Range::from_zero([0.0].into_iter()),
            Range::logarithmic([0.0, -1.0].into_iter()),
            Range::logarithmic([3.0].into_iter()),
            Range::around([2.0].into_iter()),
            Range::around([f64::NAN].into_iter()),
        ] {
            assert!(range.max > range.min, "{range:?}");
            assert!(
                range.share(range.min).abs() < 1e-12
                    && (range.share(range.max) - 1.0).abs() < 1e-12,
                "{range:?}"
            );
        }
    }
}
