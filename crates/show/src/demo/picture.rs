//! The moving picture of the demo: a hand rests on the wall while the feed-forward is off, on and off again.
//!
//! The device is drawn in slow motion with its motion magnified, next to the wall's force. The motion is SMIL, which
//! browsers play in an `<img>` without scripts. A viewer without motion, or a reader who prefers less of it, sees the
//! device at rest and the whole curve.

use super::Demo;
use super::comparison::Comparison;
use super::crossing::{Crossing, Moment, PHASES, ripple_about_moving_mean};
use crate::plot::Picture;
use crate::plot::axes::{Axis, PlotArea};
use crate::plot::canvas::{Anchor, Canvas, SMALL_TEXT, Stroke};
use crate::plot::colour::{FAINT_GREY, INK, OFF_COLOUR, WASHOUT_COLOUR};
use crate::plot::linkage;
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::skeleton::{Point, Skeleton, skeleton};

const PICTURE_WIDTH: f64 = 760.0;
const PICTURE_HEIGHT: f64 = 440.0;
/// Seconds of the picture per simulated second.
const SLOW_MOTION_FACTOR: f64 = 12.0;
/// Factor by which the device's motion is drawn larger than it is.
const MAGNIFICATION: f64 = 30.0;
/// The drawn device: its left and top edge, and its size, pixels.
const DEVICE: (Point, Point) = ((90.0, 160.0), (230.0, 190.0));
/// Half the length of the drawn wall, and the drawn depth of its solid side, pixels.
const WALL: (f64, f64) = (90.0, 40.0);
/// Time at the end of each phase over which its ripple is computed, s.
const SETTLED_TIME: f64 = 0.1;
const COLOURS: [&str; 3] = [OFF_COLOUR, WASHOUT_COLOUR, OFF_COLOUR];
/// Shows either the resting or the moving drawing.
const STYLE: &str = "<style>.moving{display:none}@media (prefers-reduced-motion:no-preference)\
    {.still{display:none}.moving{display:inline}}</style>";

/// Draws the `moments` of [`press_while_switching`](crate::view::world::press_while_switching), with the comparison of two
/// crossings in words.
pub fn draw(demo: &Demo, moments: &[Moment], without: &Crossing, with: &Crossing) -> Picture {
    let begin = moments.first().map_or(0.0, |moment| moment.time);
    let mut until = 0.0;
    let phases = PHASES.map(|duration| {
        let from = until;
        until += duration;
        let of = moments.iter().filter(move |moment| (from..until + 1e-9).contains(&(moment.time - begin)));
        of.collect::<Vec<_>>()
    });
    let ripples = phases.each_ref().map(|phase| {
        let settled = phase.len().saturating_sub((SETTLED_TIME * demo.rate_hz) as usize);
        ripple_about_moving_mean(&phase[settled..].iter().map(|moment| moment.force).collect::<Vec<_>>())
    });
    let mut canvas = Canvas::new(PICTURE_WIDTH, PICTURE_HEIGHT);
    canvas.write(format_args!("{STYLE}"));
    canvas.text((24.0, 34.0), 19.0, Anchor::Start, false, "A hand presses on a virtual wall");
    let quieter = format!("with the feed-forward: {:.0} times quieter", ripples[0] / ripples[1]);
    canvas.text((PICTURE_WIDTH - 24.0, 34.0), 15.0, Anchor::End, false, &quieter);
    draw_switch(&mut canvas);
    draw_device(&mut canvas, demo, moments, &phases[1]);
    draw_force(&mut canvas, begin, &phases, ripples);
    let [better, worse] = Comparison::of(without, with).sentences();
    let wall = format!(
        "The wall that the page opens with: {:.1} kN/m and {:.0} N s/m, control at {:.0} kHz, a tenth of the usual dry friction.",
        demo.stiffness / 1000.0,
        demo.damping,
        demo.rate_hz / 1000.0
    );
    let scale = format!(
        "A simulated board runs the firmware's control code. Shown {SLOW_MOTION_FACTOR} times slower; motion into the wall {MAGNIFICATION} times larger."
    );
    for (line, text) in [wall, scale].iter().enumerate() {
        canvas.text((24.0, PICTURE_HEIGHT - 32.0 + 16.0 * line as f64), SMALL_TEXT, Anchor::Start, false, text);
    }
    let description = format!(
        "The wall's force ripples by {:.2} N rms without the feed-forward and by {:.2} N rms with it. When the hand of \
         `haptic demo` crosses a wall: {better} {worse}",
        ripples[0], ripples[1]
    );
    canvas.finish("A virtual wall buzzes without the feed-forward, and rests with it", &description)
}

/// Returns an SMIL animation that repeats with the whole picture: values at equal intervals of time, unless `more` gives
/// key times. `more` is further attributes, each after a space.
fn animation(element: &str, attribute: &str, mode: &str, values: &[String], more: &str) -> String {
    let duration = SLOW_MOTION_FACTOR * PHASES.iter().sum::<f64>();
    format!(
        r#"<{element} attributeName="{attribute}" calcMode="{mode}" dur="{duration}s" repeatCount="indefinite" values="{}"{more}/>"#,
        values.join(";")
    )
}

/// Returns an animation that shows an element in the phases without or with the feed-forward.
fn visibility_animation(with: bool) -> String {
    let total: f64 = PHASES.iter().sum();
    let [off, on] = if with { ["hidden", "visible"] } else { ["visible", "hidden"] };
    let times = format!(r#" keyTimes="0;{:.4};{:.4}""#, PHASES[0] / total, (PHASES[0] + PHASES[1]) / total);
    animation("animate", "visibility", "discrete", &[off, on, off].map(String::from), &times)
}

/// Draws the switch of the feed-forward.
fn draw_switch(canvas: &mut Canvas) {
    canvas.text((24.0, 68.0), 15.0, Anchor::Start, false, "feed-forward");
    canvas.write(format_args!(r#"<g class="moving">"#));
    for (with, word, colour, knob) in [(false, "off", OFF_COLOUR, 144.0), (true, "on", WASHOUT_COLOUR, 168.0)] {
        canvas.write(format_args!("<g>{}", visibility_animation(with)));
        canvas.line((144.0, 63.0), (168.0, 63.0), Stroke { colour, width: 24.0, dash: "" });
        canvas.write(format_args!(r#"<g stroke-linecap="round">"#));
        canvas.line((144.0, 63.0), (168.0, 63.0), Stroke::solid(colour, 24.0));
        canvas.write(format_args!("</g>"));
        canvas.circle((knob, 63.0), 9.0, "white", Stroke::solid("white", 0.0));
        canvas.coloured_text((190.0, 68.0), 15.0, Anchor::Start, colour, word);
        canvas.write(format_args!("</g>"));
    }
    canvas.write(format_args!("</g>"));
}

/// Draws the wall and the device, at rest and moving along the wall's normal. The device rests where it settles in the
/// phase `with` the feed-forward.
fn draw_device(canvas: &mut Canvas, demo: &Demo, moments: &[Moment], with: &[&Moment]) {
    let Some(depth) = with.last().map(|moment| moment.distance) else { return };
    let Ok(linearised) = Linearised::at(&demo.file.description, demo.q(), &demo.normal) else { return };
    // Pose with the tip moved by this distance along the normal, m.
    let pose = |far: f64| -> Option<Skeleton> {
        let q: Vec<f64> = demo.q().iter().zip(linearised.unit_motion.iter()).map(|(q, per)| q + far * per).collect();
        skeleton(&demo.file.description, &q)
    };
    let Some(rest) = pose(0.0) else { return };
    let (low, high) = linkage::bounding_box(rest.bars.iter().flat_map(|bar| [bar.from, bar.to]));
    let (at, size) = DEVICE;
    let scale = (size.0 / (high.0 - low.0)).min(size.1 / (high.1 - low.1));
    let pixel = |(x, y): Point| (at.0 + scale * (x - low.0), at.1 + scale * (high.1 - y));
    let ([nx, ny], tip) = (demo.normal, pixel(rest.tip));
    // Coordinates along the wall and into its solid side, from the tip at rest.
    let wall = |along: f64, depth: f64| (tip.0 - along * ny - depth * nx, tip.1 - along * nx + depth * ny);
    let ((half, deep), edge) = (WALL, scale * MAGNIFICATION * depth);
    canvas.polygon(&[wall(-half, edge), wall(half, edge), wall(half, deep), wall(-half, deep)], FAINT_GREY, 0.3);
    canvas.line(wall(-half, edge), wall(half, edge), Stroke::solid(FAINT_GREY, 1.6));
    canvas.text(wall(half - 14.0, deep - 22.0), 13.0, Anchor::Start, false, "wall");
    let path = |skeleton: &Skeleton| -> String {
        let line = |bar: &haptic_stability::skeleton::Bar| {
            let (from, to) = (pixel(bar.from), pixel(bar.to));
            format!("M{:.1} {:.1}L{:.1} {:.1}", from.0, from.1, to.0, to.1)
        };
        skeleton.bars.iter().map(line).collect()
    };
    let poses: Vec<Skeleton> = moments
        .iter()
        .map(|moment| pose(MAGNIFICATION * (moment.distance - depth)).unwrap_or_else(|| rest.clone()))
        .collect();
    let links: Vec<String> = poses.iter().map(path).collect();
    let tips: Vec<String> =
        poses.iter().map(|pose| pixel(pose.tip)).map(|to| format!("{:.1} {:.1}", to.0 - tip.0, to.1 - tip.1)).collect();
    let links = animation("animate", "d", "linear", &links, "");
    let tips = animation("animateTransform", "transform", "linear", &tips, r#" type="translate""#);
    for (class, links, tips) in [("still", "", ""), ("moving", links.as_str(), tips.as_str())] {
        canvas.write(format_args!(
            r#"<g class="{class}"><path d="{}" fill="none" stroke="{INK}" stroke-width="4" stroke-linecap="round">{links}</path><g>{tips}"#,
            path(&rest)
        ));
        // The hand pushes from the open side.
        let hand = |along: f64, up: f64| wall(along, -up);
        canvas.line(hand(0.0, 52.0), hand(0.0, 16.0), Stroke::solid(FAINT_GREY, 3.0));
        canvas.polygon(&[hand(0.0, 9.0), hand(-6.0, 20.0), hand(6.0, 20.0)], FAINT_GREY, 1.0);
        let name = hand(10.0, 46.0);
        canvas.text(name, 13.0, Anchor::Start, false, "hand");
        linkage::draw_tip(canvas, tip);
        canvas.write(format_args!("</g></g>"));
    }
    for base in &rest.base {
        linkage::draw_base_pivot(canvas, pixel(*base));
    }
}

/// Draws the wall's force over time, with its ripple in each phase.
fn draw_force(canvas: &mut Canvas, begin: f64, phases: &[Vec<&Moment>; 3], ripples: [f64; 3]) {
    let highest = phases.iter().flatten().map(|moment| moment.force).fold(0.0, f64::max);
    let frame = PlotArea {
        at: (420.0, 92.0),
        size: (316.0, 230.0),
        x: Axis::new("time", "s", 0.0, PHASES.iter().sum()),
        y: Axis::new("force of the wall", "N", 0.0, 1.2 * highest),
    };
    let ((left, top), (width, height)) = (frame.at, frame.size);
    let reveal = animation("animate", "width", "linear", &["0".into(), width.to_string()], "");
    canvas.write(format_args!(
        r#"<clipPath id="past"><rect x="{left}" y="{top}" width="{width}" height="{height}">{reveal}</rect></clipPath>"#
    ));
    for (class, clip) in [("still", ""), ("moving", r#" clip-path="url(#past)""#)] {
        canvas.write(format_args!(r#"<g class="{class}"{clip}>"#));
        let mut from = 0.0;
        for (((phase, colour), ripple), duration) in phases.iter().zip(COLOURS).zip(ripples).zip(PHASES) {
            let points: Vec<Point> = phase.iter().map(|moment| (moment.time - begin, moment.force)).collect();
            frame.curve(canvas, &points, Stroke::solid(colour, 1.4));
            let word = if colour == OFF_COLOUR { "off" } else { "on" };
            let at = frame.pixel(from + duration / 2.0, 1.2 * highest);
            canvas.coloured_text((at.0, at.1 + 18.0), 13.0, Anchor::Middle, colour, word);
            let ripple = format!("{ripple:.2} N rms");
            canvas.coloured_text((at.0, at.1 + 34.0), SMALL_TEXT, Anchor::Middle, colour, &ripple);
            from += duration;
        }
        canvas.write(format_args!("</g>"));
    }
    frame.draw(canvas, "");
}
