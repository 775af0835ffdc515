//! The terminal's screen: state, tip and walls, two signals, numbers, what was said, keys. It fits any size: parts are
//! left out if there is no room, but never the state or the last message.

use super::seen::{Seen, Trace, WallSeen, number, numbers};
use crate::outline::Outline;
use crate::plot::signals::quantity;
use haptic_host::words::with_unit;
use haptic_host::words::{bytes_in_words, short};
use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::canvas::{Canvas, Circle, Context, Line as Stroke};
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType, Paragraph, Wrap};

const KEYS: &str = "hold Space: motors on · x: off · arrows: lead the hand, g: let go · w: wall · k j: stiffness · l h: damping · \
                    f: feed-forward · y: go there anyway · 1 2: signals · s: time · r: record · c: clear fault · t: take command · q: end";

/// Fewer columns than this do not hold a device's name and its state.
const NARROW: u16 = 40;

/// Draws everything.
pub fn draw(frame: &mut Frame<'_>, seen: &Seen) {
    let area = frame.area();
    let keys = Paragraph::new(KEYS).wrap(Wrap { trim: true }).style(Style::new().fg(Color::DarkGray));
    let keys_high = if area.height < 18 { 0 } else { (KEYS.chars().count() as u16).div_ceil(area.width.max(1)) + 1 };
    let said_high = if seen.said.is_some() || seen.lost.is_some() || !seen.picture["fault"].is_null() { 2 } else { 0 };
    let (told_of_gains, unstable) = gains_in_words(seen);
    let gains_high = lines_of(&told_of_gains, area.width);
    let numbers_high = 2 + u16::from(area.width < 100);
    // A layout that does not fit shrinks what it likes, the line of the motors too: what comes first here has its room.
    let mut left = area.height;
    let [head, said, gains, below, foot] = [1, said_high, gains_high, numbers_high, keys_high].map(|wanted| {
        let high = wanted.min(left);
        left -= high;
        high
    });
    let [head, said, middle, gains, below, foot] =
        Layout::vertical([head, said, left, gains, below, foot].map(Constraint::Length)).areas(area);
    let alarm = if unstable { Style::new().fg(Color::Red).add_modifier(Modifier::BOLD) } else { Style::new() };
    frame.render_widget(Paragraph::new(state(seen, area.width)), head);
    frame.render_widget(Paragraph::new(words(seen)).wrap(Wrap { trim: true }), said);
    frame.render_widget(Paragraph::new(told_of_gains).style(alarm).wrap(Wrap { trim: true }), gains);
    frame.render_widget(Paragraph::new(told(seen)).wrap(Wrap { trim: true }), below);
    frame.render_widget(keys, foot);
    if middle.height < 6 {
        return;
    }
    let wide = middle.width >= 70;
    let [left, right] = Layout::horizontal(if wide {
        [Constraint::Percentage(42), Constraint::Fill(1)]
    } else {
        [Constraint::Length(0), Constraint::Fill(1)]
    })
    .areas(middle);
    if wide {
        stage(frame, left, seen);
    }
    let [first, second] =
        Layout::vertical([Constraint::Fill(1), Constraint::Fill(u16::from(middle.height >= 12))]).areas(right);
    for (plot, area) in [first, second].into_iter().enumerate() {
        if area.height > 2 {
            signal(frame, area, seen, plot);
        }
    }
}

/// Number of lines that words take when they are wrapped.
fn lines_of(words: &str, width: u16) -> u16 {
    let (mut lines, mut column) = (1, 0);
    for word in words.split_whitespace().map(|word| word.chars().count()) {
        let after = if column == 0 { word } else { column + 1 + word };
        (lines, column) = if column > 0 && after > usize::from(width) { (lines + 1, word) } else { (lines, after) };
    }
    lines
}

/// The line of the board's state. The state of the motors comes first, in case there is no room for all.
fn state(seen: &Seen, width: u16) -> Line<'_> {
    let device = seen.hello["device"].as_str().unwrap_or("no board yet");
    let badge = |words, colour| Span::styled(format!(" {words} "), Style::new().bg(colour).fg(Color::Black));
    let (words, short, colour) = match (seen.lost.is_some(), seen.picture["state"].as_str()) {
        (true, _) => ("no connection", "lost", Color::Red),
        (_, Some("Armed")) => ("motors on", "on", Color::Green),
        (_, Some("Fault")) => ("fault", "fault", Color::Red),
        (_, Some("CheckingPolarity")) => ("checking polarity", "check", Color::Yellow),
        (_, Some(_)) => ("motors off", "off", Color::Gray),
        (_, None) => ("waiting", "wait", Color::Gray),
    };
    let state = badge(if usize::from(width) < words.len() + 2 { short } else { words }, colour);
    let role = match (seen.commands(), seen.picture["command"].is_null()) {
        (true, _) => "you command",
        (_, true) => "nobody commands",
        _ => "another page commands",
    };
    let device = Span::styled(device, Style::new().add_modifier(Modifier::BOLD));
    let mut spans = if width < NARROW { vec![state, " ".into(), device] } else { vec![device, " ".into(), state] };
    spans.push(format!(" {role}").into());
    if !seen.hello["rows_hz"].is_null() {
        spans.push(format!(" · {} rows a second", number(&seen.hello["rows_hz"]).round()).into());
    }
    let recording = &seen.picture["recording"];
    if !recording.is_null() {
        let (rows, bytes) = (number(&recording["rows"]), number(&recording["bytes"]));
        let size = bytes_in_words(bytes as u64);
        spans.push(Span::styled(format!(" ● recording {rows} rows, {size}"), Style::new().fg(Color::Red)));
    }
    Line::from(spans)
}

/// Faults and losses first, then what was last said.
fn words(seen: &Seen) -> Line<'_> {
    let bad = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
    match (&seen.lost, seen.picture["fault"].as_str(), &seen.said) {
        (Some(why), _, _) => Line::styled(format!("{why}; waiting for it"), bad),
        (None, Some(fault), _) => Line::styled(format!("Fault: {fault}"), bad),
        (None, None, Some((words, true))) => Line::styled(words.as_str(), bad),
        (None, None, Some((words, false))) => Line::from(words.as_str()),
        (None, None, None) => Line::default(),
    }
}

/// The wall at hand, and whether its gains are predicted to be unstable.
fn gains_in_words(seen: &Seen) -> (String, bool) {
    let spring = match seen.springs.len() {
        0 => String::new(),
        count => format!("; {}", haptic_host::words::counted(count, "spring")),
    };
    match seen.walls.get(seen.wall) {
        None => (format!("no wall in this scene{spring}"), false),
        Some(WallSeen { shape, stiffness, damping, feed_forward, .. }) => {
            let limit = seen.stable_to();
            let unstable = limit.is_some_and(|(most, _)| f64::from(*stiffness) > most);
            let (stiffness, damping) = (short(*stiffness), short(*damping));
            let which = seen.wall;
            // A word and a sign first, for who sees no colours or little of the line.
            let mark = if unstable { "! UNSTABLE: " } else { "" };
            let most = match limit {
                Some((0.0, _)) => " · predicted stable at no stiffness with this damping".into(),
                Some((most, hz)) => {
                    let buzz =
                        hz.filter(|_| unstable).map_or(String::new(), |hz| format!(", buzzing at about {hz:.0} Hz"));
                    format!(" · predicted stable up to {}{buzz}", with_unit(most, "N/m"))
                }
                None => String::new(),
            };
            let gains = format!("{stiffness} N/m, {damping} N s/m, feed-forward {}", feed_forward.name());
            (format!("{mark}wall {which} ({shape}): {gains}{most}{spring}"), unstable)
        }
    }
}

fn told(seen: &Seen) -> String {
    let picture = &seen.picture;
    if picture.is_null() {
        return String::new();
    }
    let of = |name: &str, unit: &str| with_unit(number(&picture["numbers"][name]), unit);
    let depth = number(&picture["numbers"]["depth"]);
    let inertia = match numbers(&picture["numbers"]["inertia"])[..] {
        [without, with] => format!("inertia without / with {} / {}", with_unit(without, "kg"), with_unit(with, "kg")),
        _ => "inertia –".into(),
    };
    let load = match (picture["speed"].as_f64(), picture["load"].as_f64()) {
        (Some(speed), _) => format!("simulation's speed {:.0} %", 100.0 * speed),
        (None, Some(load)) => format!("interrupt's load {:.0} %", 100.0 * load),
        (None, None) => "interrupt's load –".into(),
    };
    [
        format!("force {}", of("force", "N")),
        if depth > 0.0 { format!("depth {}", with_unit(depth, "m")) } else { "outside".into() },
        format!("sideways {}", of("sideways", "N")),
        format!("ripple {} rms", of("ripple", "N")),
        match picture["state"] == "Armed" {
            true => format!("energy taken up {}", of("energy", "J")),
            false => "energy taken up –".into(),
        },
        format!("cut by a limit {:.0} %", 100.0 * number(&picture["numbers"]["saturated"])),
        inertia,
        format!("rows lost {}", number(&picture["lost"])),
        load,
    ]
    .join(" · ")
}

/// Tip, links, walls and springs to scale.
fn stage(frame: &mut Frame<'_>, area: Rect, seen: &Seen) {
    let geometry = &seen.picture["geometry"];
    let point = |value: &serde_json::Value| match numbers(value)[..] {
        [x, y, ..] => Some((x, y)),
        _ => None,
    };
    let points = |value: &serde_json::Value| -> Vec<(f64, f64)> {
        value.as_array().map(Vec::as_slice).unwrap_or_default().iter().filter_map(point).collect()
    };
    let bars: Vec<((f64, f64), (f64, f64))> = geometry["bars"]
        .as_array()
        .map(Vec::as_slice)
        .unwrap_or_default()
        .iter()
        .filter_map(|bar| point(&bar[0]).zip(point(&bar[1])))
        .collect();
    let (tip, base, springs) = (point(&geometry["tip"]), points(&geometry["base"]), points(&geometry["springs"]));
    let flat = seen.hello["task"].as_u64().is_none_or(|task| task > 1);
    let near = |at: &(f64, f64)| tip.is_some_and(|tip| (at.0 - tip.0).hypot(at.1 - tip.1) < 0.12);
    let walls = seen.walls.iter().filter_map(|wall| wall.outline).map(|outline| outline.at().into());
    let shown =
        bars.iter().flat_map(|bar| [bar.0, bar.1]).chain(base.iter().copied()).chain(tip).chain(walls.filter(near));
    let far = (f64::INFINITY, f64::NEG_INFINITY);
    let (x, y) = shown.fold((far, far), |(x, y), (px, py)| ((x.0.min(px), x.1.max(px)), (y.0.min(py), y.1.max(py))));
    let block = Block::bordered().title(" tip and walls ");
    let inner = block.inner(area);
    if x.0 > x.1 || inner.width < 4 || inner.height < 2 {
        frame.render_widget(block, area);
        return;
    }
    // A character is two dots wide and four high, and dots are square.
    let (dots_x, dots_y) = (2.0 * f64::from(inner.width), 4.0 * f64::from(inner.height));
    let dot = ((x.1 - x.0 + 0.03) / dots_x).max((y.1 - y.0 + 0.03) / dots_y);
    let ends = |(low, high): (f64, f64), dots: f64| [0.5 * (low + high - dots * dot), 0.5 * (low + high + dots * dot)];
    let (x_ends, y_ends) = (ends(x, dots_x), ends(y, dots_y));
    let long = (dots_x + dots_y) * dot;
    let force = numbers(&geometry["force"]);
    let hand = point(&seen.picture["hand"]["at"]).map(|at| seen.placed(at));
    let canvas = Canvas::default().block(block).marker(Marker::Braille).x_bounds(x_ends).y_bounds(y_ends).paint(|c| {
        let line = |c: &mut Context<'_>, from: (f64, f64), to: (f64, f64), color: Color| {
            c.draw(&Stroke { x1: from.0, y1: from.1, x2: to.0, y2: to.1, color });
        };
        for wall in seen.walls.iter().filter(|wall| flat || wall.outline.is_some()) {
            draw_wall(c, wall, long, dot);
        }
        for (spring, held) in seen.springs.iter().zip(&springs).filter(|_| flat) {
            if let [dx, dy, ..] = numbers(&spring["direction"])[..] {
                let along = |s: f64| (held.0 + s * dx, held.1 + s * dy);
                line(c, along(-long), along(long), Color::Magenta);
            }
            if let Some(tip) = tip {
                line(c, *held, tip, Color::Magenta);
            }
        }
        c.layer();
        for (from, to) in &bars {
            line(c, *from, *to, Color::Gray);
        }
        if let Some(tip) = tip {
            c.draw(&Circle { x: tip.0, y: tip.1, radius: 2.0 * dot, color: Color::Cyan });
            if let [fx, fy, ..] = force[..] {
                // A newton is four dots.
                line(c, tip, (tip.0 + 4.0 * dot * fx, tip.1 + 4.0 * dot * fy), Color::Red);
            }
        }
        if let Some(hand) = hand {
            c.draw(&Circle { x: hand.0, y: hand.1, radius: 3.5 * dot, color: Color::Yellow });
        }
    });
    frame.render_widget(canvas, area);
}

fn draw_wall(c: &mut Context<'_>, wall: &WallSeen, long: f64, dot: f64) {
    let color = Color::Blue;
    match wall.outline {
        Some(Outline::Line { at: [px, py], normal: [nx, ny] }) => {
            let mut line = |depth: f64, from: f64, to: f64| {
                let at = |s: f64| (px - depth * nx - s * ny, py - depth * ny + s * nx);
                let ((x1, y1), (x2, y2)) = (at(from), at(to));
                c.draw(&Stroke { x1, y1, x2, y2, color });
            };
            line(0.0, -long, long);
            // A dotted line on the solid side.
            for i in -40..40 {
                let s = f64::from(i) * 6.0 * dot;
                line(3.0 * dot, s, s + 2.0 * dot);
            }
        }
        Some(Outline::Circle { at: [x, y], radius, .. }) => c.draw(&Circle { x, y, radius, color }),
        None => {
            if let [x, y, ..] = wall.values[..] {
                c.print(x, y, format!("{}: not drawn", wall.shape));
            }
        }
    }
}

fn signal(frame: &mut Frame<'_>, area: Rect, seen: &Seen, plot: usize) {
    let (name, seconds) = (seen.signals[plot].as_str(), seen.seconds());
    let none = Trace::default();
    let trace = seen.traces.get(plot).unwrap_or(&none);
    let count = trace.columns.len().max(2) as f64 - 1.0;
    let columns = trace.columns.iter().enumerate().filter(|(_, (low, high))| low <= high);
    let points: Vec<(f64, f64)> = columns
        .flat_map(|(i, (low, high))| {
            let t = seconds * (i as f64 / count - 1.0);
            [(t, f64::from(*low)), (t, f64::from(*high))]
        })
        .collect();
    let far = (f64::INFINITY, f64::NEG_INFINITY);
    let (low, high) = points.iter().fold(far, |(low, high), (_, v)| (low.min(*v), high.max(*v)));
    let (low, high) = if low > high { (0.0, 0.0) } else { (low, high) };
    let room = (0.05 * (high - low)).max(1e-9).max(1e-3 * high.abs());
    let dataset = Dataset::default()
        .marker(Marker::Braille)
        .graph_type(GraphType::Line)
        .data(&points)
        .style(Style::new().fg(if plot == 0 { Color::Cyan } else { Color::Yellow }));
    let unit = quantity(name).unit;
    let with = |value: f64| with_unit(value, &unit);
    let title = format!(" {}: {name}, {} to {} ", plot + 1, with(low), with(high));
    let (bottom, top) = (low - room, high + room);
    let window = if seconds < 1.0 { format!("{:.0} ms", 1e3 * seconds) } else { format!("{seconds} s") };
    let chart = Chart::new(vec![dataset])
        .block(Block::bordered().title(title))
        .x_axis(Axis::default().bounds([-seconds, 0.0]).labels([format!("-{window}"), "now".into()]))
        .y_axis(Axis::default().bounds([bottom, top]).labels([bottom, 0.5 * (bottom + top), top].map(with)));
    frame.render_widget(chart, area);
}

/// The same with nothing but ASCII, for terminals that show no other characters: a cell of dots becomes one that says
/// whether they are above, below or both.
pub fn in_ascii(buffer: &mut Buffer) {
    for cell in &mut buffer.content {
        let Some(symbol) = cell.symbol().chars().next().filter(|symbol| !symbol.is_ascii()) else { continue };
        let plain = match symbol {
            '\u{2800}' => " ",
            '\u{2801}'..='\u{28ff}' => match (symbol as u32 & UPPER_DOTS > 0, symbol as u32 & LOWER_DOTS > 0) {
                (true, false) => "'",
                (false, _) => ".",
                (true, true) => ":",
            },
            '│' | '·' => "|",
            '─' | '–' => "-",
            '┌' | '┐' | '└' | '┘' => "+",
            'µ' => "u",
            '●' | '•' => "*",
            _ => "?",
        };
        cell.set_symbol(plain);
    }
}

/// The upper four dots of a Braille character, and the lower four.
const UPPER_DOTS: u32 = 0x1b;
const LOWER_DOTS: u32 = 0xe4;

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    /// A board before a wall of 8700 N/m whose boundary ends lower or higher, with two traces.
    fn seen(state: &str, most: f64) -> Seen {
        let mut seen = Seen::default();
        for text in [
            r#"{"is":"hello","device":"five-bar","task":2,"simulated":true,"rows_hz":1000,"columns":["rendered_n","distance_m"]}"#
                .to_string(),
            r#"{"is":"walls","walls":[{"shape":"plane","values":[0,0,0,0,1,0],"stiffness":8700,"damping":80,
                "feed_forward":"off","outline":{"is":"line","at":[0,0.1],"normal":[0,1]}}],"springs":[]}"#
                .to_string(),
            format!(
                r#"{{"is":"plane","plane":{{"wall":0,"w_eff":0.2,"w_rr":0.3,"full":[],"washout":[],"off":[
                    {{"kd":0,"kp":{most},"hz":70}},{{"kd":100,"kp":{most},"hz":70}}]}}}}"#
            ),
            format!(
                r#"{{"is":"picture","state":"{state}","command":null,"numbers":{{}},
                    "geometry":{{"tip":[0.02,0.1],"bars":[[[0,0],[0.02,0.1]]],"base":[[0,0]],"springs":[],"force":[0,2]}}}}"#
            ),
        ] {
            seen.hear(&text);
        }
        let ramp = |low: f32| (0..50).map(|i| (low + 0.1 * i as f32, low + 0.1 * i as f32)).collect();
        seen.traces = vec![Trace { columns: ramp(-2.0) }, Trace { columns: ramp(0.001) }];
        seen
    }

    fn drawn(seen: &Seen, width: u16, height: u16) -> Buffer {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, seen)).unwrap();
        terminal.backend().buffer().clone()
    }

    fn text(buffer: &Buffer) -> String {
        let rows = buffer.content.chunks(usize::from(buffer.area.width).max(1));
        rows.map(|row| row.iter().map(|cell| cell.symbol()).collect::<String>() + "\n").collect()
    }

    #[test]
    fn gains_beyond_the_boundary_are_marked_by_a_word_and_a_colour() {
        for (most, unstable) in [(6000.0, true), (0.0, true), (9000.0, false)] {
            for (width, height) in [(120, 40), (80, 24), (44, 8), (20, 5)] {
                let buffer = drawn(&seen("Armed", most), width, height);
                assert_eq!(
                    text(&buffer).contains("! UNSTABLE"),
                    unstable,
                    "{most} {width}x{height}\n{}",
                    text(&buffer)
                );
                let red = buffer.content.iter().any(|cell| cell.symbol() == "8" && cell.fg == Color::Red);
                assert_eq!(red, unstable, "{most} {width}x{height}");
            }
        }
        let words = |most: f64| text(&drawn(&seen("Armed", most), 160, 40));
        assert!(words(6000.0).contains("stable up to 6.00 kN/m, buzzing at about 70 Hz"), "{}", words(6000.0));
        assert!(words(0.0).contains("stable at no stiffness") && !words(9000.0).contains("buzzing"));
    }

    #[test]
    fn the_motors_state_is_there_at_every_size() {
        for (state, words, short) in [("Armed", " motors on ", " on "), ("Disarmed", " motors off ", " off ")] {
            let mut seen = seen(state, 6000.0);
            for said in [None, Some(("a message of some length".to_string(), true))] {
                seen.said = said;
                for (width, height) in [(160, 50), (80, 24), (40, 12), (39, 6), (20, 5), (20, 1), (12, 5), (5, 1)] {
                    let text = text(&drawn(&seen, width, height));
                    let first = text.lines().next().unwrap();
                    assert!(first.contains(if width < 12 { short } else { words }), "{width}x{height}\n{text}");
                }
            }
        }
        drawn(&seen("Armed", 1.0), 0, 0);
    }

    #[test]
    fn the_plots_have_axes_with_units() {
        let text = text(&drawn(&seen("Armed", 6000.0), 120, 40));
        for label in ["│-2.25 N│", "│3.15 N │", "1: rendered_n, -2.00 N to 2.90 N", "2: distance_m, 1.00 mm to 4.90 m"]
        {
            assert!(text.contains(label), "{label} in\n{text}");
        }
    }

    #[test]
    fn without_other_characters_the_screen_is_ascii() {
        let mut buffer = drawn(&seen("Armed", 6000.0), 120, 40);
        let before = text(&buffer);
        in_ascii(&mut buffer);
        let text = text(&buffer);
        assert!(text.is_ascii() && !text.contains('?'), "{text}");
        let dots = |text: &str, dots: &dyn Fn(char) -> bool| text.chars().filter(|c| dots(*c)).count();
        let braille = dots(&before, &|c| ('\u{2801}'..='\u{28ff}').contains(&c));
        assert!(braille > 100 && dots(&text, &|c| "'.:".contains(c)) >= braille, "{text}");
    }

    /// The wall of a paddle crosses the arc of its tip, and its solid side is dotted, as other walls are.
    #[test]
    fn the_wall_of_a_paddle_lies_across_its_arc() {
        let mut seen = Seen::default();
        for text in [
            r#"{"is":"hello","device":"paddle","task":1,"simulated":true,"rows_hz":1000,"columns":["rendered_n"]}"#,
            r#"{"is":"walls","walls":[{"shape":"plane","values":[-0.02,0,0,1,0,0],"stiffness":100,"damping":1,
                "feed_forward":"off","outline":{"is":"line","at":[0.0671,-0.0197],"normal":[0.282,0.959]}}],"springs":[]}"#,
            r#"{"is":"picture","state":"Disarmed","command":null,"numbers":{},"hand":{"at":[0.01,0],"goal":[0.01,0]},
                "geometry":{"tip":[0.07,0],"bars":[[[0,0],[0.07,0]]],"base":[[0,0]],"springs":[],"force":[0,0]}}"#,
        ] {
            seen.hear(text);
        }
        let mut terminal = Terminal::new(TestBackend::new(120, 40)).unwrap();
        terminal.draw(|frame| draw(frame, &seen)).unwrap();
        let buffer = terminal.backend().buffer().clone();
        let of = |colour: Color| -> Vec<(u16, u16)> {
            let stage = (0..50).flat_map(|x| (0..40).map(move |y| (x, y)));
            stage.filter(|at| buffer[*at].fg == colour && buffer[*at].symbol() != " ").collect()
        };
        // From edge to edge of a stage of 50 columns, and down to the right.
        let wall = of(Color::Blue);
        assert!(wall.len() > 40, "{wall:?}");
        let row = |x: u16| wall.iter().filter(|at| at.0.abs_diff(x) < 3).map(|at| at.1).max().unwrap();
        assert!(row(45) > row(5), "{wall:?}");
        // The hand is on the arc as well, a step of it goes along it, and of a wall that is refused nothing is left.
        assert!(of(Color::Yellow).iter().all(|(x, _)| *x > 20), "{:?}", of(Color::Yellow));
        let Some(crate::view::message::FromPage::Hand { at: Some([arc, _]) }) = seen.lead(0.0, 1e-3) else { panic!() };
        assert!((arc - 0.011).abs() < 2e-5, "{arc}");
        seen.hear(r#"{"is":"refused","of":"gains","why":"too stiff","again":{"do":"take"}}"#);
        assert!(seen.said.is_some());
        seen.hear(r#"{"is":"walls","walls":[],"springs":[]}"#);
        assert!(seen.said.is_none() && seen.again().is_none());
    }
}
