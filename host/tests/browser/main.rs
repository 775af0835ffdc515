//! `haptic view` in a real browser, without a screen. A computer without Chromium fails here, with the line that installs
//! it. With HAPTIC_PICTURES set to a folder, pictures of the page are left there for a person to look at.

mod devtools;
#[path = "../view/page.rs"]
mod page;

use devtools::{Browser, Tab};
use page::View;
use serde_json::Value;

const LAPTOP: (u32, u32) = (1366, 768);
const PHONE: (u32, u32) = (390, 844);
const PROJECTOR: (u32, u32) = (1920, 1080);

fn opened() -> (View, Browser, Tab) {
    let view = View::start(&["--port", "sim"]);
    let mut browser = Browser::start();
    let tab = browser.open(&view.url, LAPTOP, 1.0);
    browser.until(
        &tab,
        "window.view && view.pictures > 3 && view.plane !== null && document.body.dataset.role === 'command'",
    );
    browser.front(&tab);
    (view, browser, tab)
}

/// A place on a canvas, in pixels of the page; `x` and `y` are expressions in its own pixels.
fn on(browser: &mut Browser, tab: &Tab, canvas: &str, x: &str, y: &str) -> (f64, f64) {
    let place =
        format!("(() => {{ const r = $('{canvas}').getBoundingClientRect(); return [r.left + {x}, r.top + {y}]; }})()");
    let place = browser.evaluate(tab, &place);
    (place[0].as_f64().unwrap(), place[1].as_f64().unwrap())
}

fn on_plane(browser: &mut Browser, tab: &Tab, damping: f64, stiffness: f64) -> (f64, f64) {
    on(browser, tab, "plane", &format!("view.planeFrame.X({damping})"), &format!("view.planeFrame.Y({stiffness})"))
}

/// A place in front of the wall by so many metres.
fn by_the_wall(browser: &mut Browser, tab: &Tab, before: f64) -> (f64, f64) {
    let along = |i: u8| format!("(view.walls[0].values[{i}] + {before} * view.walls[0].values[{}])", i + 3);
    on(browser, tab, "stage", &format!("view.frame.toX({})", along(0)), &format!("view.frame.toY({})", along(1)))
}

/// Leads the hand by the mouse to 2 cm behind the wall's surface, and notes the place in `view.goal`.
fn lead_into_the_wall(browser: &mut Browser, tab: &Tab) {
    let tip = on(
        browser,
        tab,
        "stage",
        "view.frame.toX(view.last.geometry.tip[0])",
        "view.frame.toY(view.last.geometry.tip[1])",
    );
    let tip = (tip.0, tip.1 - 25.0);
    let goal = by_the_wall(browser, tab, -0.02);
    browser.drag(tab, tip, goal);
    browser.evaluate(tab, "(v => view.goal = [v[0] - 0.02 * v[3], v[1] - 0.02 * v[4]])(view.walls[0].values)");
    // All of the way: the hand is there with the mouse's first step.
    let there = "view.last.hand && Math.hypot(view.last.hand.goal[0] - view.goal[0], view.last.hand.goal[1] - view.goal[1]) < 2e-3";
    browser.hold_until(tab, there);
}

#[test]
fn the_page_loads_is_alive_and_asks_nobody_else() {
    let (view, mut browser, tab) = opened();
    let count = |browser: &mut Browser, what: &str| browser.evaluate(&tab, what).as_u64().unwrap();
    let (pictures, sweeps) = (count(&mut browser, "view.pictures"), count(&mut browser, "view.sweeps"));
    browser.until(&tab, &format!("view.pictures > {} && view.sweeps > {}", pictures + 20, sweeps + 10));
    browser.evaluate(&tab, "$('sound').click()");
    browser.until(&tab, "view.sounds > 5");
    assert_eq!(browser.evaluate(&tab, "document.title"), "coupled-five-bar: haptic view");
    // Everything is drawn: no canvas is of one colour.
    for canvas in ["stage", "plane", "scope"] {
        let colours = browser.evaluate(
            &tab,
            &format!(
                "(() => {{ const c = $('{canvas}'); const d = new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, \
                 c.height).data.buffer); return new Set(d).size; }})()"
            ),
        );
        assert!(colours.as_u64().unwrap() > 20, "{canvas}: {colours} colours");
    }
    let own = [view.url.clone(), format!("ws://{}/live", view.address())];
    let elsewhere: Vec<String> = browser.requested().into_iter().filter(|url| !own.contains(url)).collect();
    assert!(elsewhere.iter().all(|url| url == "about:blank" || url.starts_with("data:")), "{elsewhere:?}");
    assert_eq!(browser.complaints(), [""; 0]);
}

#[test]
fn a_key_that_is_held_arms_and_letting_go_disarms() {
    let (_view, mut browser, tab) = opened();
    let armed = "document.body.dataset.state === 'Armed'";
    let off = "document.body.dataset.state === 'Disarmed'";
    browser.hold_until(&tab, armed);
    browser.space(&tab, "keyUp");
    browser.until(&tab, off);
    // The button, by the mouse.
    let key = on(&mut browser, &tab, "key", "60", "30");
    browser.mouse(&tab, "mousePressed", key);
    browser.until(&tab, "view.last.held");
    browser.mouse(&tab, "mouseReleased", key);
    browser.until(&tab, off);
    // Focus that goes elsewhere is a hand that may be elsewhere.
    browser.hold_until(&tab, armed);
    browser.evaluate(&tab, "window.dispatchEvent(new Event('blur'))");
    browser.until(&tab, off);
    assert_eq!(browser.complaints(), [""; 0]);
}

#[test]
fn a_page_that_is_closed_disarms_and_the_other_one_may_command_then() {
    let (view, mut browser, first) = opened();
    let second = browser.open(&view.url, PHONE, 2.0);
    browser.until(&second, "window.view && view.pictures > 3");
    assert_eq!(browser.evaluate(&second, "document.body.dataset.role"), "watch");
    assert_eq!(browser.evaluate(&second, "$('key').disabled && $('take').disabled"), true);
    browser.front(&first);
    browser.hold_until(&first, "document.body.dataset.state === 'Armed'");
    browser.close(&first);
    browser.until(&second, "document.body.dataset.state === 'Disarmed' && view.last.command === null");
    browser.front(&second);
    browser.evaluate(&second, "$('take').click()");
    browser.until(&second, "document.body.dataset.role === 'command'");
    browser.hold_until(&second, "document.body.dataset.state === 'Armed'");
}

#[test]
fn the_dot_is_dragged_and_stops_at_the_boundary_until_one_goes_on() {
    let (_view, mut browser, tab) = opened();
    let (from, to) = (on_plane(&mut browser, &tab, 40.0, 22e3), on_plane(&mut browser, &tab, 60.0, 10e3));
    browser.drag(&tab, from, to);
    // A pixel of the picture is some tens of newtons a metre.
    browser.until(&tab, "Math.abs(view.walls[0].damping - 60) < 1 && Math.abs(view.walls[0].stiffness - 10e3) < 200");
    assert_eq!(
        browser.evaluate(&tab, "$('stiffness').value === String(+view.walls[0].stiffness.toPrecision(4))"),
        true
    );
    let beyond = on_plane(&mut browser, &tab, 60.0, 23e3);
    browser.drag(&tab, to, beyond);
    browser.until(
        &tab,
        "$('notice').classList.contains('shown') && $('why').textContent.includes('predicted to be unstable')",
    );
    assert_eq!(browser.evaluate(&tab, "view.walls[0].stiffness < 21e3"), true, "it stays on the stable side");
    browser.evaluate(&tab, "$('anyway').click()");
    browser.until(&tab, "view.walls[0].stiffness > 21e3 && document.body.dataset.stable === 'false'");
}

#[test]
fn the_wall_is_pressed_by_the_mouse_and_its_feed_forward_changed_under_it() {
    let (_view, mut browser, tab) = opened();
    browser.hold_until(&tab, "document.body.dataset.state === 'Armed'");
    lead_into_the_wall(&mut browser, &tab);
    browser.hold_until(&tab, "view.last.numbers.force > 2 && view.last.numbers.depth > 0");
    browser.evaluate(&tab, "$('ff-off').click()");
    browser.until(&tab, "!$('anyway').hidden");
    browser.evaluate(&tab, "$('anyway').click()");
    browser.until(&tab, "view.walls[0].feed_forward === 'off'");
    browser.evaluate(&tab, "$('ff-washout').click()");
    browser.until(&tab, "view.walls[0].feed_forward === 'washout'");
    browser.space(&tab, "keyUp");
    browser.until(&tab, "document.body.dataset.state === 'Disarmed'");
    // A wall is dragged by its handle.
    browser.evaluate(&tab, "view.goal = null; $('let-go').click()");
    browser.until(&tab, "view.last.hand === null");
    let handle = on(
        &mut browser,
        &tab,
        "stage",
        "view.frame.toX(wallHandle(view.walls[0])[0])",
        "view.frame.toY(wallHandle(view.walls[0])[1])",
    );
    let before = browser.evaluate(&tab, "view.walls[0].values[1]").as_f64().unwrap();
    browser.drag(&tab, handle, (handle.0, handle.1 + 60.0));
    browser.until(&tab, &format!("view.walls[0].values[1] < {before} - 0.01"));
    assert_eq!(browser.complaints(), [""; 0]);
}

/// At every size nothing sticks out and the key is in sight; pictures for a person to look at.
#[test]
fn the_page_fits_a_phone_a_laptop_and_a_projector() {
    let (_view, mut browser, tab) = opened();
    browser.hold_until(&tab, "document.body.dataset.state === 'Armed'");
    lead_into_the_wall(&mut browser, &tab);
    browser.hold_until(&tab, "view.last.numbers.force > 2");
    for (name, size, scale, dark) in [
        ("laptop", LAPTOP, 1.0, false),
        ("laptop-dark", LAPTOP, 1.0, true),
        ("phone", PHONE, 2.0, false),
        ("phone-dark", PHONE, 2.0, true),
        ("projector", PROJECTOR, 1.0, false),
    ] {
        browser.size(&tab, size, scale);
        browser.evaluate(&tab, &format!("theme({dark})"));
        let pictures = browser.evaluate(&tab, "view.pictures").as_u64().unwrap();
        browser.until(&tab, &format!("view.pictures > {}", pictures + 20));
        let fits = browser.evaluate(
            &tab,
            "(() => { const k = $('key').getBoundingClientRect(); return {wide: document.documentElement.scrollWidth, \
             key: k.bottom <= innerHeight && k.top > 0, canvases: ['stage', 'plane', 'scope'].map(i => $(i).clientHeight)}; })()",
        );
        assert!(fits["wide"].as_u64().unwrap() <= u64::from(size.0), "{name}: {fits}");
        assert_eq!(fits["key"], true, "{name}");
        let heights: Vec<Value> = fits["canvases"].as_array().unwrap().clone();
        assert!(heights.iter().all(|height| height.as_u64().unwrap() >= 110), "{name}: {fits}");
        if let Ok(folder) = std::env::var("HAPTIC_PICTURES") {
            let png = browser.picture(&tab, size == PHONE);
            std::fs::write(format!("{folder}/view-{name}.png"), png).unwrap();
        }
    }
}
