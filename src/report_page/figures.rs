//! The figures, in SVG. Hollow marks show errors before the calibration, solid marks show errors after it, so that the figures can be read without
//! colour.

use super::axes::{Frame, Labels, Range, WIDTH, place};
use super::text::{self, SMALLEST_MM};
use crate::wire::measurement::Subset;
use crate::wire::report_shape::{Convergence, PointReport};
use maud::{Markup, html};

/// Maximum number of bars that can be distinguished on paper. With more points, neighbouring points share a bar.
const MAX_BARS: usize = 160;
/// Maximum number of arrows. More arrows would cover each other.
const MAX_ARROWS: usize = 300;
/// Maximum number of corners of a curve. More corners would not be visible.
const MAX_CORNERS: usize = 500;
/// Number of columns of the histogram.
const COLUMNS: usize = 24;
/// Ratio of the largest to the median error above which the axis is logarithmic. On a linear axis, small errors would not be visible.
const LOG_FROM_RATIO: f64 = 40.0;

fn figure(
    width: f64,
    title: &str,
    caption: &str,
    before: Option<&str>,
    height: f64,
    content: Markup,
) -> Markup {
    html! {
        figure {
            figcaption {
                h2 { (title) }
                p { (caption) @if let Some(robot) = before { " " (key("before")) " before (" (robot) ") " (key("after")) " after (identified robot)" } }
            }
            svg viewBox={ "0 0 " (width) " " (height) } role="img" aria-label=(title) { (content) }
        }
    }
}

fn key(kind: &str) -> Markup {
    html! { svg.key viewBox="0 0 12 10" aria-hidden="true" { rect class=(kind) x="0.5" y="0.5" width="11" height="9" {} } }
}

fn spans_much(points: &[PointReport]) -> bool {
    let largest = points
        .iter()
        .flat_map(|p| [p.before_mm, p.after_mm])
        .fold(0.0, f64::max);
    median(points.iter().map(|p| p.after_mm)) * LOG_FROM_RATIO < largest
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// The range of the errors. A logarithmic range has a margin, so that the smallest bar is visible. Errors below what can be measured are raised to
/// [`SMALLEST_MM`].
fn error_range(points: &[PointReport], log: bool) -> Range {
    let errors = points.iter().flat_map(|p| [p.before_mm, p.after_mm]);
    if log {
        Range::logarithmic(errors.map(|v| v.max(SMALLEST_MM)))
    } else {
        Range::from_zero(errors)
    }
}

/// A bar for one point, or for several neighbouring points; then it shows their largest error.
struct Bar {
    before_mm: f64,
    after_mm: f64,
}

fn bars(points: &[&PointReport], share: usize) -> Vec<Bar> {
    let largest = |some: &[&PointReport], of: fn(&PointReport) -> f64| {
        some.iter().map(|p| of(p)).fold(0.0, f64::max)
    };
    points
        .chunks(share)
        .map(|some| Bar {
            before_mm: largest(some, |p| p.before_mm),
            after_mm: largest(some, |p| p.after_mm),
        })
        .collect()
}

/// The error of each point before and after, the verify half first.
pub fn per_point(points: &[PointReport], before: &str) -> Markup {
    if points.is_empty() {
        return html! {};
    }
    let log = spans_much(points);
    let share = points.len().div_ceil(MAX_BARS);
    let halves: Vec<(String, Vec<Bar>)> =
        [(Subset::Verify, "verify"), (Subset::Identify, "identify")]
            .into_iter()
            .map(|(subset, name)| {
                let half: Vec<&PointReport> =
                    points.iter().filter(|p| p.subset == subset).collect();
                (format!("{name}: {} points", half.len()), bars(&half, share))
            })
            .filter(|(_, half)| !half.is_empty())
            .collect();
    let count: usize = halves.iter().map(|(_, half)| half.len()).sum();
    let gap = if halves.len() > 1 { 1.5 } else { 0.0 };
    let x = Range {
        min: 0.0,
        max: count as f64 + gap,
        log: false,
    };
    let frame = Frame {
        x,
        y: error_range(points, log),
        width: WIDTH,
        height: 190.0,
    };
    let axis = if log { " on a logarithmic axis" } else { "" };
    let each = if share > 1 {
        format!(" Each bar is the largest of {share} neighbours.")
    } else {
        String::new()
    };
    let caption = format!(
        "Position error of each measured point, mm{axis}.{each} The verify points were not fitted."
    );
    figure(
        WIDTH,
        "Error per point",
        &caption,
        Some(before),
        frame.height,
        per_point_content(&frame, &halves, gap),
    )
}

fn per_point_content(frame: &Frame, halves: &[(String, Vec<Bar>)], gap: f64) -> Markup {
    let starts = halves.iter().scan(0.0, |at, (_, half)| {
        let start = *at;
        *at += half.len() as f64 + gap;
        Some(start)
    });
    html! {
        (frame.axes(&Labels { x: "", y: "mm", x_ticks: false }))
        @for ((name, half), start) in halves.iter().zip(starts) {
            text x=(place(frame.px(start + half.len() as f64 / 2.0))) y=(frame.bottom() + 16.0) text-anchor="middle" { (name) }
            @for (i, bar) in half.iter().enumerate() {
                (column(frame, "before", start + i as f64 + 0.08, 0.84, bar.before_mm))
                (column(frame, "after", start + i as f64 + 0.29, 0.42, bar.after_mm))
            }
        }
    }
}

/// A column above the x axis that begins at `at`. `at` and `width` are in units of x, `value` is in units of y.
fn column(frame: &Frame, kind: &str, at: f64, width: f64, value: f64) -> Markup {
    let value = if frame.y.log {
        value.max(SMALLEST_MM)
    } else {
        value
    };
    let (x, top) = (frame.px(at), frame.py(value));
    html! {
        rect class=(kind) x=(place(x)) y=(place(top)) width=(place(frame.px(at + width) - x)) height=(place((frame.bottom() - top).max(0.0))) {}
    }
}

/// Histogram of the errors.
pub fn histogram(points: &[PointReport], robot_before: &str) -> Markup {
    if points.is_empty() {
        return html! {};
    }
    let log = spans_much(points);
    let x = error_range(points, log);
    let counted = |of: fn(&PointReport) -> f64| {
        points.iter().fold([0usize; COLUMNS], |mut counts, p| {
            let at =
                (x.share(of(p).max(if log { SMALLEST_MM } else { 0.0 })) * COLUMNS as f64) as usize;
            counts[at.min(COLUMNS - 1)] += 1;
            counts
        })
    };
    let (before, after) = (counted(|p| p.before_mm), counted(|p| p.after_mm));
    let top = before.iter().chain(&after).max().copied().unwrap_or(1);
    let x_columns = Range {
        min: 0.0,
        max: COLUMNS as f64,
        log: false,
    };
    let y = Range {
        min: 0.0,
        max: 1.06 * top as f64,
        log: false,
    };
    let frame = Frame {
        x: x_columns,
        y,
        width: WIDTH / 2.0,
        height: 170.0,
    };
    let half = |of: fn(&PointReport) -> f64| text::error(median(points.iter().map(of)));
    let caption = format!(
        "Number of points by the size of their error, all {} points{}. Half of them are below {} mm before and {} mm after.",
        points.len(),
        if log { ", on a logarithmic axis" } else { "" },
        half(|p| p.before_mm),
        half(|p| p.after_mm)
    );
    let content = html! {
        (Frame { x, ..frame }.axes(&Labels { x: "position error, mm", y: "points", x_ticks: true }))
        @for (kind, counts, inset) in [("before", before, 0.04), ("after", after, 0.2)] {
            @for (i, count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
                (column(&frame, kind, i as f64 + inset, 1.0 - 2.0 * inset, *count as f64))
            }
        }
    };
    figure(
        WIDTH / 2.0,
        "Distribution of the errors",
        &caption,
        Some(robot_before),
        frame.height,
        content,
    )
}

/// Convergence of the cost; empty if the method has no convergence curve.
pub fn convergence(curve: &Convergence) -> Markup {
    let points: Vec<(f64, f64)> = curve
        .iteration
        .iter()
        .zip(&curve.best_cost_mm2)
        .map(|(i, cost)| (*i as f64, *cost))
        .filter(|(_, cost)| *cost > 0.0)
        .collect();
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return html! {};
    };
    if points.len() < 2 {
        return html! {};
    }
    let x = Range {
        min: 0.0,
        max: last.0.max(1.0),
        log: false,
    };
    let frame = Frame {
        x,
        y: Range::logarithmic(points.iter().map(|(_, cost)| *cost)),
        width: WIDTH / 2.0,
        height: 170.0,
    };
    let corners = thinned(&points)
        .iter()
        .map(|(i, cost)| format!("{},{}", place(frame.px(*i)), place(frame.py(*cost))))
        .collect::<Vec<_>>();
    let caption = format!(
        "The cost F, the sum of the squared position errors on the identify points, from {} to {} mm² in {} iterations.",
        text::number(first.1),
        text::number(last.1),
        last.0
    );
    let content = html! {
        (frame.axes(&Labels { x: "iteration", y: "F, mm²", x_ticks: true }))
        polyline.curve points=(corners.join(" ")) {}
    };
    figure(
        WIDTH / 2.0,
        "Convergence",
        &caption,
        None,
        frame.height,
        content,
    )
}

/// The corners of a curve that never rises: the points before and after each fall, and both ends. They are thinned to about [`MAX_CORNERS`].
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let falls = |i: usize| {
        i == 0
            || i + 1 == points.len()
            || points[i].1 < points[i - 1].1
            || points[i + 1].1 < points[i].1
    };
    let corners: Vec<(f64, f64)> = (0..points.len())
        .filter(|i| falls(*i))
        .map(|i| points[i])
        .collect();
    let every = corners.len().div_ceil(MAX_CORNERS).max(1);
    let last = corners.last().copied();
    corners.into_iter().step_by(every).chain(last).collect()
}

/// An error vector at the measured position.
struct Arrow {
    position_mm: [f64; 3],
    before_mm: [f64; 3],
    after_mm: [f64; 3],
}

/// The error vectors at the measured positions, in two projections; empty for reports without vectors.
pub fn positions(points: &[PointReport], before: &str) -> Markup {
    let placed: Vec<Arrow> = points
        .iter()
        .filter_map(|p| {
            Some(Arrow {
                position_mm: p.position_mm?,
                before_mm: p.before_vector_mm?,
                after_mm: p.after_vector_mm?,
            })
        })
        .collect();
    if placed.is_empty() {
        return html! {};
    }
    let every = placed.len().div_ceil(MAX_ARROWS);
    let arrows: Vec<&Arrow> = placed.iter().step_by(every).collect();
    let factor = magnification(&arrows);
    let left_out = if every > 1 {
        format!(" One of {every} points is drawn.")
    } else {
        String::new()
    };
    html! {
        div.pair {
            @for (title, i, j, names) in [("Seen from above", 0, 1, ["x, mm", "y, mm"]), ("Seen from the side", 0, 2, ["x, mm", "z, mm"])] {
                @let caption = format!("Arrows from where the robot was believed to be to where it was measured, {factor} times as long.{left_out}");
                (figure(WIDTH / 2.0, title, &caption, Some(before), 300.0, projection(&arrows, i, j, names, factor)))
            }
        }
    }
}

/// Magnification of the arrows: a round factor with which the longest arrow is about a seventh of the extent of the points.
fn magnification(arrows: &[&Arrow]) -> f64 {
    let extent = (0..3)
        .map(|k| Range::around(arrows.iter().map(|a| a.position_mm[k])))
        .map(|r| r.max - r.min)
        .fold(0.0, f64::max);
    let longest = arrows
        .iter()
        .map(|a| a.before_mm.iter().map(|v| v * v).sum::<f64>().sqrt())
        .fold(1e-6, f64::max);
    let raw = 0.14 * extent / longest;
    let base = 10f64.powf(raw.log10().floor());
    [5.0, 3.0, 2.0, 1.0]
        .into_iter()
        .map(|m| m * base)
        .find(|f| *f <= raw)
        .unwrap_or(1.0)
        .max(1.0)
}

fn projection(arrows: &[&Arrow], i: usize, j: usize, names: [&str; 2], factor: f64) -> Markup {
    let ends = |k: usize| {
        Range::around(
            arrows
                .iter()
                .flat_map(move |a| [a.position_mm[k], a.position_mm[k] - factor * a.before_mm[k]]),
        )
    };
    let mut frame = Frame {
        x: ends(i),
        y: ends(j),
        width: WIDTH / 2.0,
        height: 300.0,
    };
    // Both axes get the same scale.
    let per_unit = ((frame.x.max - frame.x.min) / (frame.right() - frame.left()))
        .max((frame.y.max - frame.y.min) / (frame.bottom() - frame.top()));
    frame.x = widened(frame.x, per_unit * (frame.right() - frame.left()));
    frame.y = widened(frame.y, per_unit * (frame.bottom() - frame.top()));
    html! {
        (frame.axes(&Labels { x: names[0], y: names[1], x_ticks: true }))
        @for kind in ["before", "after"] {
            @for arrow in arrows {
                @let vector = if kind == "before" { arrow.before_mm } else { arrow.after_mm };
                @let tip = [frame.px(arrow.position_mm[i]), frame.py(arrow.position_mm[j])];
                @let tail = [frame.px(arrow.position_mm[i] - factor * vector[i]), frame.py(arrow.position_mm[j] - factor * vector[j])];
                path class={ (kind) "-line" } d=(arrow_path(tail, tip)) {}
            }
        }
    }
}

fn widened(range: Range, extent: f64) -> Range {
    let middle = (range.min + range.max) / 2.0;
    Range {
        min: middle - extent / 2.0,
        max: middle + extent / 2.0,
        ..range
    }
}

fn arrow_path(tail: [f64; 2], tip: [f64; 2]) -> String {
    let (dx, dy) = (tip[0] - tail[0], tip[1] - tail[1]);
    let length = dx.hypot(dy);
    let mut path = format!(
        "M{} {}L{} {}",
        place(tail[0]),
        place(tail[1]),
        place(tip[0]),
        place(tip[1])
    );
    if length > 4.0 {
        let (ux, uy) = (4.0 * dx / length, 4.0 * dy / length);
        let barb = |side: f64| {
            format!(
                "M{} {}l{} {}",
                place(tip[0]),
                place(tip[1]),
                place(-ux - side * uy * 0.5),
                place(-uy + side * ux * 0.5)
            )
        };
        path += &(barb(1.0) + &barb(-1.0));
    }
    path
}

#[cfg(test)]
mod tests {
    use super::thinned;

    #[test]
    fn a_thinned_curve_keeps_both_ends_and_its_steps() {
        let flat: Vec<(f64, f64)> = (0..3000)
            .map(|i| (f64::from(i), if i < 1500 { 2.0 } else { 1.0 }))
            .collect();
        assert_eq!(
            &thinned(&flat)[..4],
            [(0.0, 2.0), (1499.0, 2.0), (1500.0, 1.0), (2999.0, 1.0)]
        );
        let falling: Vec<(f64, f64)> = (0..3000)
            .map(|i| (f64::from(i), f64::from(3000 - i)))
            .collect();
        let corners = thinned(&falling);
        assert!(corners.len() <= 502);
        assert_eq!(
            (corners[0], corners[corners.len() - 1]),
            ((0.0, 3000.0), (2999.0, 1.0))
        );
    }
}
