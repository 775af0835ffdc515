//! The picture of a map, after the paper's Fig. 1: coupling as colour over the plane of the linkage, with the ellipses
//! of the operational-space inertia Λ, and the linkage itself at home.
//!
//! The colour is the coupling's share of the rendered inertia, (Wrr - Weff)/Wrr, which is between 0 and 1, while the
//! coupling itself grows without bound towards singularities. The scale covers 95 % of the area, so that the rim near
//! the singularities does not use up the colours. Ellipse axes are square roots of Λ's eigenvalues.

use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Description;

use super::axes::{Axis, PlotArea};
use super::canvas::{Anchor, Canvas, Stroke};
use super::colour::{ABOVE_SCALE, FAINT_GREY, INK, scale};
use super::paper::{Page, Paper, UNIT_MM};
use super::{Picture, linkage, paddle};
use haptic_host::vectors::unit;
use haptic_host::words::with_unit;
use haptic_stability::analysis::cut::{Cut, Fineness, Tile};
use haptic_stability::analysis::map::MapPoint;
use haptic_stability::analysis::pose::PoseError;
use haptic_stability::skeleton::{Point, Skeleton, Turret, skeleton_in};

/// Minimum share of the area that the colour scale covers.
const COVERED_SHARE: f64 = 0.95;
/// Number of colours in the scale. Tiles of one colour are merged; half a colour step is not visible.
const COLOUR_COUNT: f64 = 50.0;
/// Longest side of the plane, pixels.
const PLANE_SIDE: f64 = 500.0;
/// Room to the left of the plane, and to the right of it for the colour scale, with and without the scale's name.
const LEFT_MARGIN: f64 = 86.0;
const RIGHT_MARGIN: f64 = 130.0;
const NARROW_RIGHT_MARGIN: f64 = 92.0;
const COLOUR_LABEL: &str = "coupling (Wrr - Weff)/Wrr";
/// Distance of ellipse centres, pixels, and the radius of an ellipse of typical size.
const ELLIPSE_SPACING: f64 = 56.0;
const ELLIPSE_RADIUS: f64 = 0.36 * ELLIPSE_SPACING;

/// A drawn map, with the data to read numbers off the picture.
#[derive(Clone, Debug)]
pub struct Chart {
    /// The picture.
    pub picture: Picture,
    /// Frame that maps positions to pixels.
    pub frame: PlotArea,
    /// Share at the top of the colour scale; higher shares have the colour [`ABOVE_SCALE`].
    pub top: f64,
}

/// Draws the map of a device for one normal. `admissible` selects the coordinate that a redundant device holds.
pub fn draw(
    description: &Description,
    name: &str,
    normal: &[f64],
    admissible: Admissible,
    paper: Paper,
) -> Result<Picture, PoseError> {
    if description.kind.spec().joints == 1 {
        return paddle::draw(description, name, paper);
    }
    chart(description, name, normal, admissible, paper).map(|chart| chart.picture)
}

/// Returns the colour of a share on a scale that ends at `top`.
pub fn colour(share: f64, top: f64) -> String {
    if share > top { ABOVE_SCALE.into() } else { scale((share / top * COLOUR_COUNT).round() / COLOUR_COUNT) }
}

/// Draws the map of a device with at least two joints.
pub fn chart(
    description: &Description,
    name: &str,
    normal: &[f64],
    admissible: Admissible,
    paper: Paper,
) -> Result<Chart, PoseError> {
    let cut = Cut::new(description, normal, admissible)?;
    let spec = description.kind.spec();
    let is_paddles = matches!(description.kind, Kind::Paddles2 | Kind::Paddles3);
    // A map of several paddles has one arc length on each axis, so the paddles cannot be drawn in it.
    let home = description
        .home
        .filter(|_| !is_paddles)
        .and_then(|home| skeleton_in(description, &home[..spec.joints], &cut.view));
    let coarse = cut.tiles(Fineness { side: f64::INFINITY, least: f64::INFINITY, step: f64::INFINITY, top: 1.0 });
    let (step, top, highest) = colour_scale(&coarse);

    let tips = coarse.iter().flat_map(|tile| tile.outline.iter().copied());
    let (low, high) = linkage::bounding_box(tips.chain(home.iter().flat_map(Skeleton::points)));
    let (across, up) = (high.0 - low.0, high.1 - low.1);
    // On a screen the page is as wide as the plane requires; on paper the plane is as wide as the page allows.
    let usual = PLANE_SIDE / across.max(up);
    let page = paper.page((LEFT_MARGIN + across * usual + RIGHT_MARGIN).max(620.0), LEFT_MARGIN);
    let room = if page.is_narrow() { NARROW_RIGHT_MARGIN } else { RIGHT_MARGIN };
    let title = format!("{name}: coupling of a wall's normal with free motion");
    let n = unit(normal).unwrap_or_default().iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ");
    let limits =
        if description.joints[..spec.joints].iter().all(|j| j.limits.is_none()) { "no joint limits" } else { "" };
    let notes: Vec<&str> = [cut.caption.as_str(), limits].into_iter().filter(|note| !note.is_empty()).collect();
    let mut under = vec![format!("normal n = ({n})"), notes.join("; ")];
    under.extend(page.is_narrow().then(|| format!("colour: {COLOUR_LABEL}")));
    let heading = page.heading(&title, &under);
    let top_edge = 92.0 + heading.extra_height(2);
    let pixels = page.scale(usual, (across, up), (page.left + room, top_edge + 46.0));
    let plane = if Turret::of(description.kind).is_some() { " in the linkage's plane" } else { "" };
    let frame = PlotArea {
        at: (page.left, top_edge),
        size: (across * pixels, up * pixels),
        x: Axis::new(format!("{}{plane}", cut.view.names[0]), "m", low.0, high.0),
        y: Axis::new(format!("{}{plane}", cut.view.names[1]), "m", low.1, high.1),
    };
    let bottom = frame.at.1 + frame.size.1;
    let axis_note = if Turret::of(description.kind).is_some() { " (such as joint 0's axis)" } else { "" };
    let notes = [
        format!("coloured: positions that the tip reaches from home, clear of singular poses{axis_note}"),
        "arm pose as at home; other arm poses with the same tip position are not drawn".into(),
    ];
    let notes = page.notes(notes.iter().map(String::as_str));
    let key_high = if paper.is_printed() { 46.0 } else { 106.0 };
    let mut canvas = page.canvas(bottom + key_high + notes.height());
    heading.draw(&mut canvas);

    let fine = cut.tiles(Fineness { side: 12.0 / pixels, least: 3.0 / pixels, step: 2.0 * top / COLOUR_COUNT, top });
    frame.draw_clipped(&mut canvas, |canvas| draw_tiles(canvas, &frame, &fine, top));
    let typical = draw_ellipses(&mut canvas, &frame, &cut, pixels)?;
    if let Some(home) = &home {
        linkage::draw_linkage(&mut canvas, &frame, home);
    }
    frame.draw(&mut canvas, "");

    draw_normal(&mut canvas, (frame.at.0 + frame.size.0 + 44.0, bottom + 24.0), cut.project(normal));
    draw_colour_bar(&mut canvas, &frame, step, top, highest, !page.is_narrow());
    let mass = typical.map(|typical| round_step(typical / 2.5));
    let size =
        typical.zip(mass).map(|(typical, mass)| (ELLIPSE_RADIUS * (mass / typical).sqrt(), with_unit(mass, "kg")));
    if !paper.is_printed() {
        draw_key(&mut canvas, &page, bottom + 74.0, size, home.is_some());
    } else if let Some((radius, mass)) = size {
        let wide = 2.0 * UNIT_MM * radius;
        canvas.caption([format!("ellipses: axes ∝ √eigenvalues of Λ; a circle of {wide:.1} mm is {mass}").as_str()]);
    }
    notes.draw(&mut canvas, bottom + 112.0);
    let picture =
        canvas.finish(&title, "Coupling between rendered and admissible motion over the reachable workspace.");
    Ok(Chart { picture, frame, top })
}

/// Returns the tick step and the top of the colour scale, and the highest share.
fn colour_scale(tiles: &[Tile]) -> (f64, f64, f64) {
    let mut shares: Vec<(f64, f64)> = tiles.iter().map(|tile| (tile.share, tile.area())).collect();
    shares.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = shares.iter().map(|(_, area)| area).sum();
    let mut below = 0.0;
    let covering = shares.iter().find(|(_, area)| {
        below += area;
        below >= COVERED_SHARE * total
    });
    let covered = covering.map_or(0.0, |(share, _)| *share).max(1e-3);
    let step = round_step(covered / 5.0);
    let top = step * (covered / step - 1e-9).ceil();
    (step, top, shares.last().map_or(0.0, |(share, _)| *share))
}

/// Returns the smallest of 1, 2, 5 times a power of ten that is at least `least`.
fn round_step(least: f64) -> f64 {
    let power = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0, 10.0].map(|s| s * power).into_iter().find(|s| *s >= least * (1.0 - 1e-9)).unwrap_or(least)
}

/// Draws the tiles, all tiles of one colour as one shape.
fn draw_tiles(canvas: &mut Canvas, frame: &PlotArea, tiles: &[Tile], top: f64) {
    let mut shapes = std::collections::BTreeMap::<String, Vec<Vec<Point>>>::new();
    for tile in tiles {
        let outline = tile.outline.iter().map(|&(x, y)| frame.pixel(x, y)).collect();
        shapes.entry(colour(tile.share, top)).or_default().push(outline);
    }
    for (fill, outlines) in shapes {
        canvas.tiles(&outlines, &fill);
    }
}

/// Draws ellipses on a regular lattice, all to one scale. Returns the mass (kg) that has the radius [`ELLIPSE_RADIUS`].
fn draw_ellipses(canvas: &mut Canvas, frame: &PlotArea, cut: &Cut, pixels: f64) -> Result<Option<f64>, PoseError> {
    let spacing = ELLIPSE_SPACING / pixels;
    let off = |(x, y): Point| {
        let cell = ((x / spacing).round(), (y / spacing).round());
        ((cell.0 as i64, cell.1 as i64), (x - cell.0 * spacing).hypot(y - cell.1 * spacing))
    };
    let points = cut.points(|place| off(place).1 < 0.3 * spacing)?;
    let mut sizes: Vec<f64> = points.iter().filter_map(|p| p.eigenvalues.last().copied()).collect();
    sizes.sort_by(f64::total_cmp);
    let Some(&typical) = sizes.get(sizes.len() / 2) else { return Ok(None) };
    let mut chosen = std::collections::BTreeMap::<(i64, i64), (f64, &MapPoint)>::new();
    // Skips ellipses near singularities, because they are so long that they hide their neighbours.
    for point in points.iter().filter(|p| p.eigenvalues.last().is_some_and(|&l| l < 3.0 * typical)) {
        let (cell, off) = off(cut.project(&point.position));
        let best = chosen.entry(cell).or_insert((off, point));
        if off < best.0 {
            *best = (off, point);
        }
    }
    for (_, point) in chosen.values() {
        let centre = cut.project(&point.position);
        let outline: Vec<(f64, f64)> = (0..=48)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 48.0).sin_cos();
                let mut at = frame.pixel(centre.0, centre.1);
                for (value, vector) in point.eigenvalues.iter().zip(&point.eigenvectors) {
                    let axis = cut.project(vector);
                    let reach = ELLIPSE_RADIUS * (value / typical).sqrt() * (cos * axis.0 + sin * axis.1);
                    at = (at.0 + reach * axis.0, at.1 - reach * axis.1);
                }
                at
            })
            .collect();
        let inside = |&(x, y): &(f64, f64)| {
            (frame.at.0..=frame.at.0 + frame.size.0).contains(&x)
                && (frame.at.1..=frame.at.1 + frame.size.1).contains(&y)
        };
        if outline.iter().all(inside) {
            canvas.polyline(&outline, Stroke::solid("white", 2.4));
            canvas.polyline(&outline, Stroke::solid(INK, 1.0));
        }
    }
    Ok(Some(typical))
}

/// Draws the wall's normal in the plane with its middle at `middle`.
fn draw_normal(canvas: &mut Canvas, middle: Point, (nx, ny): Point) {
    let length = nx.hypot(ny);
    if length < 1e-9 {
        return;
    }
    let (ux, uy) = (nx / length, -ny / length);
    let from = (middle.0 - 16.0 * ux, middle.1 - 16.0 * uy);
    let to = (middle.0 + 16.0 * ux, middle.1 + 16.0 * uy);
    canvas.line(from, to, Stroke::solid(INK, 1.8));
    for side in [-1.0, 1.0] {
        let back = (to.0 - 8.0 * ux + side * 4.5 * uy, to.1 - 8.0 * uy - side * 4.5 * ux);
        canvas.line(to, back, Stroke::solid(INK, 1.8));
    }
    canvas.text((middle.0 + 14.0 * uy.abs() + 8.0, middle.1 + 16.0 * ux.abs() + 4.0), 13.0, Anchor::Start, false, "n");
}

/// Draws the colour scale to the right of the frame, with its name next to it if `name` is true.
fn draw_colour_bar(canvas: &mut Canvas, frame: &PlotArea, step: f64, top: f64, highest: f64, name: bool) {
    let left = frame.at.0 + frame.size.0 + 22.0;
    let above = if highest > top { 26.0 } else { 0.0 };
    let (start, height) = (frame.at.1 + above, frame.size.1 - above);
    let steps = 120;
    for i in 0..steps {
        let y = start + height * (1.0 - f64::from(i + 1) / f64::from(steps));
        let fill = scale(f64::from(i) / f64::from(steps - 1));
        canvas.rectangle((left, y), (16.0, height / f64::from(steps) + 0.6), &fill, Stroke::solid(&fill, 0.0));
    }
    canvas.rectangle((left, start), (16.0, height), "none", Stroke::solid(INK, 1.0));
    let percent = 100.0 * step;
    let decimals = (-(percent.log10() + 1e-9).floor()).clamp(0.0, 6.0) as usize;
    let text = |share: f64| format!("{:.decimals$} %", 100.0 * share);
    if above > 0.0 {
        canvas.rectangle((left, frame.at.1), (16.0, 18.0), ABOVE_SCALE, Stroke::solid(INK, 1.0));
        canvas.text((left + 24.0, frame.at.1 + 13.0), 11.5, Anchor::Start, false, &format!("> {}", text(top)));
    }
    let ticks = (top / step).round() as i32;
    for i in 0..=ticks {
        let share = f64::from(i) * step;
        let y = start + height * (1.0 - share / top);
        canvas.line((left + 16.0, y), (left + 20.0, y), Stroke::solid(INK, 1.0));
        canvas.text((left + 24.0, y + 4.0), 11.5, Anchor::Start, false, &text(share));
    }
    let middle = frame.at.1 + frame.size.1 / 2.0;
    if name {
        canvas.text((left + 88.0, middle), 12.5, Anchor::Middle, true, COLOUR_LABEL);
    }
}

/// Draws the key: a circle of this radius for a mass, and the linkage.
fn draw_key(canvas: &mut Canvas, page: &Page, y: f64, size: Option<(f64, String)>, home: bool) {
    let mut x = page.begin;
    if let Some((radius, mass)) = size {
        canvas.circle((x + ELLIPSE_RADIUS, y), radius, "none", Stroke::solid(INK, 1.0));
        x += 2.0 * ELLIPSE_RADIUS + 8.0;
        canvas.text((x, y - 2.0), 11.5, Anchor::Start, false, &format!("circle: {mass} in every direction"));
        canvas.text((x, y + 13.0), 11.5, Anchor::Start, false, "(ellipse axes ∝ √eigenvalues of Λ)");
        x += 240.0;
    }
    if home {
        canvas.line((x, y + 3.0), (x + 26.0, y - 5.0), Stroke::solid(FAINT_GREY, 1.8));
        linkage::draw_base_pivot(canvas, (x, y + 3.0));
        linkage::draw_tip(canvas, (x + 26.0, y - 5.0));
        canvas.text((x + 38.0, y + 4.0), 11.5, Anchor::Start, false, "base, and tip at home");
    }
}
