//! `haptic view` in a real browser without a screen. Without Chromium these tests fail and print the command that
//! installs it. If HAPTIC_PICTURES names a folder, screenshots of the page are written there for visual inspection.

#[path = "../common/mod.rs"]
mod common;

mod as_a_file;
mod devtools;
mod serial;

use common::page::View;
use common::{Folder, shipped_path};
use devtools::{Browser, Tab};
use serde_json::{Value, json};

const LAPTOP: (u32, u32) = (1366, 768);
const PHONE: (u32, u32) = (390, 844);
const PROJECTOR: (u32, u32) = (1920, 1080);

fn open_page() -> (View, Browser, Tab) {
    let view = View::start(&["--port", "sim"]);
    let mut browser = Browser::start();
    let tab = browser.open(&view.url, LAPTOP, 1.0);
    browser.wait_until(
        &tab,
        "window.view && view.pictures > 3 && view.plane !== null && document.body.dataset.role === 'command'",
    );
    browser.bring_to_front(&tab);
    as_an_expert(&mut browser, &tab);
    // Places on the canvases are known after the first drawing. A page draws only in front, and late if the computer is
    // busy.
    browser.wait_until(&tab, "Boolean(view.frame && view.planeFrame)");
    (view, browser, tab)
}

/// Ends what the page does by itself, resets the simulation, shows all controls, and waits until they are laid out and
/// the range is computed for the pose at rest.
fn as_an_expert(browser: &mut Browser, tab: &Tab) {
    browser.evaluate(tab, "$('rail').checked = false; $('start-over').click(); touched = true; unfold(true)");
    browser.wait_until(
        tab,
        "view.last.hand === null && view.walls.every(wall => wall.feed_forward !== 'off' || !view.hello.smooth)",
    );
    browser.evaluate(tab, "view.settled = [view.pictures + 10, view.sweeps + 5]");
    browser.wait_until(
        tab,
        "view.pictures > view.settled[0] && view.sweeps > view.settled[1] && Boolean(view.planeFrame)",
    );
}

/// Lets the page treat its simulated board as a real one, with the motors off.
fn as_on_a_board(browser: &mut Browser, tab: &Tab) {
    browser.evaluate(tab, "$('off').click(); view.hello.simulated = false");
    browser.wait_until(tab, "document.body.dataset.state === 'Disarmed'");
}

/// Returns a place on a canvas in pixels of the page; `x` and `y` are expressions in pixels of the canvas.
fn place_on(browser: &mut Browser, tab: &Tab, canvas: &str, x: &str, y: &str) -> (f64, f64) {
    let place =
        format!("(() => {{ const r = $('{canvas}').getBoundingClientRect(); return [r.left + {x}, r.top + {y}]; }})()");
    let place = browser.evaluate(tab, &place);
    (place[0].as_f64().unwrap(), place[1].as_f64().unwrap())
}

fn plane_place(browser: &mut Browser, tab: &Tab, damping: f64, stiffness: f64) -> (f64, f64) {
    place_on(
        browser,
        tab,
        "plane",
        &format!("view.planeFrame.X({damping})"),
        &format!("view.planeFrame.Y({stiffness})"),
    )
}

/// Drags the handle of the first wall down and waits until the wall has followed.
fn drag_the_wall(browser: &mut Browser, tab: &Tab) {
    let handle = place_on(
        browser,
        tab,
        "stage",
        "view.frame.toX(wallHandle(view.walls[0])[0])",
        "view.frame.toY(wallHandle(view.walls[0])[1])",
    );
    let before = browser.evaluate(tab, "view.walls[0].values[1]").as_f64().unwrap();
    browser.drag(tab, handle, (handle.0, handle.1 + 60.0));
    browser.wait_until(tab, &format!("view.walls[0].values[1] < {before} - 0.01"));
}

/// Returns the place on the page at this distance in front of the wall, m.
fn place_before_wall(browser: &mut Browser, tab: &Tab, before: f64) -> (f64, f64) {
    let along = |i: u8| format!("(view.walls[0].values[{i}] + {before} * view.walls[0].values[{}])", i + 3);
    place_on(browser, tab, "stage", &format!("view.frame.toX({})", along(0)), &format!("view.frame.toY({})", along(1)))
}

/// Drags the hand with the mouse to 2 cm behind the wall's surface and stores the place in `view.goal`.
fn lead_into_the_wall(browser: &mut Browser, tab: &Tab) {
    let tip = place_on(
        browser,
        tab,
        "stage",
        "view.frame.toX(view.last.geometry.tip[0])",
        "view.frame.toY(view.last.geometry.tip[1])",
    );
    let tip = (tip.0, tip.1 - 25.0);
    let goal = place_before_wall(browser, tab, -0.02);
    browser.drag(tab, tip, goal);
    browser.evaluate(tab, "(v => view.goal = [v[0] - 0.02 * v[3], v[1] - 0.02 * v[4]])(view.walls[0].values)");
    let there = "view.last.hand && Math.hypot(view.last.hand.goal[0] - view.goal[0], view.last.hand.goal[1] - view.goal[1]) < 2e-3";
    browser.hold_until(tab, there);
}

#[test]
fn the_page_is_alive_and_requests_nothing_elsewhere() {
    let (view, mut browser, tab) = open_page();
    let count = |browser: &mut Browser, what: &str| browser.evaluate(&tab, what).as_u64().unwrap();
    let (pictures, sweeps) = (count(&mut browser, "view.pictures"), count(&mut browser, "view.sweeps"));
    browser.wait_until(&tab, &format!("view.pictures > {} && view.sweeps > {}", pictures + 20, sweeps + 10));
    browser.evaluate(&tab, "$('sound').click()");
    browser.wait_until(&tab, "view.sounds > 5");
    assert_eq!(browser.evaluate(&tab, "document.title"), "coupled-five-bar: haptic view");
    // A canvas with many colours has been drawn.
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
    let elsewhere: Vec<String> = browser.requested_urls().into_iter().filter(|url| !own.contains(url)).collect();
    assert!(elsewhere.iter().all(|url| url == "about:blank" || url.starts_with("data:")), "{elsewhere:?}");
    assert_eq!(browser.console_errors(), [""; 0]);
}

#[test]
fn holding_the_key_arms_and_releasing_it_disarms() {
    let (_view, mut browser, tab) = open_page();
    let armed = "document.body.dataset.state === 'Armed'";
    let off = "document.body.dataset.state === 'Disarmed'";
    // Simulated motors are on without a key; a click of the button turns them off, and on again.
    browser.wait_until(&tab, armed);
    browser.evaluate(&tab, "window.dispatchEvent(new Event('blur'))");
    for state in [off, armed] {
        browser.evaluate(&tab, "$('key').click()");
        browser.wait_until(&tab, state);
    }
    as_on_a_board(&mut browser, &tab);
    browser.hold_until(&tab, armed);
    browser.send_space(&tab, "keyUp");
    browser.wait_until(&tab, off);
    // Space arms with the focus on any control and does not change that control. In a number field Space does not arm.
    for control in ["ff-off", "beyond", "channel-a", "before", "trigger"] {
        browser.evaluate(
            &tab,
            &format!("$('{control}').focus(); window.was = [$('{control}').value, $('{control}').checked]"),
        );
        browser.hold_until(&tab, armed);
        browser.send_space(&tab, "keyUp");
        browser.wait_until(&tab, off);
        let same = format!("$('{control}').value === was[0] && $('{control}').checked === was[1]");
        assert_eq!(browser.evaluate(&tab, &same), true, "{control}");
    }
    browser.evaluate(&tab, "$('stiffness').focus()");
    browser.send_space(&tab, "keyDown");
    browser.send_space(&tab, "keyUp");
    browser.evaluate(&tab, "window.then = view.pictures");
    browser.wait_until(&tab, "view.pictures > then + 10");
    assert_eq!(browser.evaluate(&tab, "view.down || view.last.state === 'Armed'"), false);
    browser.evaluate(&tab, "document.activeElement.blur()");
    // The key is held only while the mouse button is down.
    let key = place_on(&mut browser, &tab, "key", "60", "30");
    for (what, down) in [("mousePressed", true), ("mouseReleased", false)] {
        browser.send_mouse(&tab, what, key);
        assert_eq!(browser.evaluate(&tab, "view.down"), down);
    }
    browser.wait_until(&tab, off);
    // Losing the focus releases the key.
    browser.hold_until(&tab, armed);
    browser.evaluate(&tab, "window.dispatchEvent(new Event('blur'))");
    browser.wait_until(&tab, off);
    assert_eq!(browser.console_errors(), [""; 0]);
}

/// On a phone one finger holds the key while another taps; the browser sends no click for such a tap.
#[test]
fn a_second_finger_taps_while_the_first_holds_the_key() {
    let (_view, mut browser, tab) = open_page();
    as_on_a_board(&mut browser, &tab);
    browser.size(&tab, PHONE, 2.0);
    browser.call_page(&tab, "Emulation.setTouchEmulationEnabled", json!({"enabled": true, "maxTouchPoints": 2}));
    let touch = |browser: &mut Browser, kind: &str, fingers: &[(f64, f64)]| {
        let points = fingers.iter().enumerate().map(|(id, (x, y))| json!({"x": x, "y": y, "id": id}));
        browser.call_page(
            &tab,
            "Input.dispatchTouchEvent",
            json!({"type": kind, "touchPoints": points.collect::<Vec<_>>()}),
        );
    };
    let key = place_on(&mut browser, &tab, "key", "60", "30");
    touch(&mut browser, "touchStart", &[key]);
    browser.wait_until(&tab, "view.down");
    let off = place_on(&mut browser, &tab, "ff", "20", "15");
    touch(&mut browser, "touchStart", &[key, off]);
    assert_eq!(
        browser.evaluate(&tab, "view.down && $('anyway').hidden"),
        true,
        "the tap counts when the finger is lifted"
    );
    // The debugging protocol lifts all fingers together.
    touch(&mut browser, "touchEnd", &[]);
    browser.wait_until(&tab, "!view.down && !$('anyway').hidden");
    browser.wait_until(&tab, "document.body.dataset.state === 'Disarmed'");
    assert_eq!(browser.console_errors(), [""; 0]);
}

#[test]
fn closing_the_page_disarms_and_frees_the_command() {
    let (view, mut browser, first) = open_page();
    let second = browser.open(&view.url, PHONE, 2.0);
    browser.wait_until(&second, "window.view && view.pictures > 3");
    assert_eq!(browser.evaluate(&second, "document.body.dataset.role"), "watch");
    assert_eq!(browser.evaluate(&second, "$('key').disabled && $('take').disabled"), true);
    // A watching page shows no notice until it requests a change, which is refused.
    let notice = "$('notice').classList.contains('shown')";
    assert_eq!(browser.evaluate(&second, notice), false);
    browser.evaluate(&second, "$('ff-off').click()");
    browser.wait_until(&second, &format!("{notice} && $('why').textContent.includes('this one watches')"));
    browser.bring_to_front(&first);
    browser.hold_until(&first, "document.body.dataset.state === 'Armed'");
    browser.close(&first);
    browser.wait_until(&second, "document.body.dataset.state === 'Disarmed' && view.last.command === null");
    assert_eq!(browser.evaluate(&second, notice), false, "the notice disappears when no other page is in command");
    browser.bring_to_front(&second);
    browser.evaluate(&second, "$('take').click()");
    browser.wait_until(&second, "document.body.dataset.role === 'command'");
    browser.hold_until(&second, "document.body.dataset.state === 'Armed'");
}

#[test]
fn the_dragged_dot_stops_at_the_boundary_until_confirmed() {
    let (_view, mut browser, tab) = open_page();
    as_on_a_board(&mut browser, &tab);
    let (from, to) = (plane_place(&mut browser, &tab, 80.0, 8700.0), plane_place(&mut browser, &tab, 40.0, 10e3));
    browser.drag(&tab, from, to);
    // One pixel of the plane is some tens of N/m.
    browser
        .wait_until(&tab, "Math.abs(view.walls[0].damping - 40) < 1 && Math.abs(view.walls[0].stiffness - 10e3) < 200");
    assert_eq!(
        browser.evaluate(&tab, "$('stiffness').value === String(+view.walls[0].stiffness.toPrecision(4))"),
        true
    );
    let top = browser.evaluate(&tab, "$('plane').getBoundingClientRect().top");
    let beyond = plane_place(&mut browser, &tab, 40.0, 23e3);
    browser.drag(&tab, to, beyond);
    browser.wait_until(
        &tab,
        "$('notice').classList.contains('shown') && $('why').textContent.includes('predicted to be unstable')",
    );
    assert_eq!(
        browser.evaluate(&tab, "$('plane').getBoundingClientRect().top"),
        top,
        "the notice does not move the plane"
    );
    let in_sight = "['ff-full', 'let-go', 'off', 'key'].every(id => { const r = $(id).getBoundingClientRect(); \
                    return $(id).contains(document.elementFromPoint(r.left + r.width / 2, r.top + r.height / 2)); })";
    assert_eq!(browser.evaluate(&tab, in_sight), true, "the notice covers none of these buttons");
    assert_eq!(
        browser.evaluate(&tab, "view.walls[0].stiffness < 21e3"),
        true,
        "without confirmation the gains stay stable"
    );
    browser.wait_until(&tab, "view.again?.stiffness > 22e3");
    // The button names the gains that it sets.
    assert_eq!(browser.evaluate(&tab, "/^Set 2[23]\\.\\d kN\\/m, .* anyway$/.test($('anyway').textContent)"), true);
    browser.evaluate(&tab, "$('anyway').click()");
    browser.wait_until(&tab, "view.walls[0].stiffness > 21e3 && document.body.dataset.stable === 'false'");
    browser.evaluate(&tab, "$('stiffness').focus(); $('stiffness').value = '1000000000'; $('stiffness').onchange()");
    browser.wait_until(&tab, "$('why').textContent.includes('motors and rules allow') && $('anyway').hidden");
    assert_eq!(browser.evaluate(&tab, "$('stiffness').valueAsNumber < 1e6"), true, "the refused value is replaced");
    browser.evaluate(&tab, "$('stiffness').value = '3000'; $('stiffness').onchange()");
    browser.wait_until(&tab, "view.walls[0].stiffness === 3000 && !$('notice').classList.contains('shown')");
}

/// Script that returns text and box of every label on the plane, in pixels.
const LABELS_SCRIPT: &str = "(() => { const k = CanvasRenderingContext2D.prototype, fill = k.fillText, found = []; \
    k.fillText = function (words, x, y) { const m = this.measureText(words), t = this.getTransform(); if (t.b === 0 && this.textAlign === 'left') \
    found.push([words, x - m.actualBoundingBoxLeft, y - m.actualBoundingBoxAscent, x + m.actualBoundingBoxRight, y + m.actualBoundingBoxDescent]); \
    return fill.call(this, words, x, y); }; drawPlane(); k.fillText = fill; return found; })()";

/// For all gains the dot keeps away from the edges, and no label covers another label or the dot.
#[test]
fn the_plane_has_no_overlaps_on_shipped_devices() {
    let mut browser = Browser::start();
    for (name, scene, scale) in [
        ("coupled-five-bar", "", "even"),
        ("hapkit-paddle", "wall", "log"),
        ("serial-3r", "wall-held", "log"),
        ("pantograph-mk2", "corner", "log"),
        ("haply-2diy", "disc", "log"),
        ("woodenhaptics", "room", "log"),
        ("capstan-pantograph", "wall", "even"),
    ] {
        let (device, scene) =
            (shipped_path(&format!("{name}.toml")), shipped_path(&format!("scenes/{name}/{scene}.toml")));
        let demo = ["--port", "sim"];
        let own = [&device, "--port", "sim", "--scene", &scene];
        let view = View::start(if name == "coupled-five-bar" { &demo } else { &own });
        let tab = browser.open(&view.url, LAPTOP, 1.0);
        browser.bring_to_front(&tab);
        browser.wait_until(&tab, "window.view && view.plane !== null && Boolean(view.planeFrame) && view.pictures > 5");
        as_an_expert(&mut browser, &tab);
        browser.wait_until(&tab, &format!("$('scale').value === '{scale}'"));
        for (size, scale) in [(LAPTOP, scale), ((1024, 768), "even"), (PHONE, "log"), (PROJECTOR, "near")] {
            browser.size(&tab, size, 1.0);
            browser.evaluate(&tab, &format!("$('scale').value = '{scale}'; window.then = view.pictures"));
            browser.wait_until(&tab, "view.pictures > then + 6");
            let words = browser.evaluate(&tab, LABELS_SCRIPT);
            let dot = browser.evaluate(
                &tab,
                "(() => { const w = view.walls[view.wall], x = view.planeFrame.X(w.damping), y = view.planeFrame.Y(w.stiffness); \
                 return [x, y, $('plane').clientWidth, $('plane').clientHeight]; })()",
            );
            let at = |value: &Value, i: usize| value[i].as_f64().unwrap();
            let boxes: Vec<[f64; 4]> =
                words.as_array().unwrap().iter().map(|word| [1, 2, 3, 4].map(|i| at(word, i))).collect();
            let what = format!("{name} {size:?} {scale}: {words} {dot}");
            assert!(boxes.len() >= 2 && words.to_string().contains("predicted stable"), "{what}");
            if scale != "even" {
                assert!(at(&dot, 0) > 50.0 && at(&dot, 1) < at(&dot, 3) - 30.0, "the dot is at an edge: {what}");
            }
            let dot = [at(&dot, 0) - 8.0, at(&dot, 1) - 8.0, at(&dot, 0) + 8.0, at(&dot, 1) + 8.0];
            let meet = |a: &[f64; 4], b: &[f64; 4]| a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
            for (i, one) in boxes.iter().enumerate() {
                assert!(!meet(one, &dot), "a label covers the dot: {what}");
                assert!(boxes[..i].iter().all(|other| !meet(one, other)), "two labels overlap: {what}");
            }
        }
        browser.evaluate(&tab, "window.from = view.walls[0].stiffness; $('plane').onkeydown(new KeyboardEvent('keydown', {key: 'ArrowUp', shiftKey: true}))");
        browser.wait_until(&tab, "Math.abs(view.walls[0].stiffness / from - 1.1) < 1e-4");
        assert_eq!(browser.console_errors(), [""; 0]);
        browser.close(&tab);
    }
}

/// Gains tried with a press are marked until the wall moves or the simulation starts over. The limiting effects are
/// shown on request.
#[test]
fn tried_gains_are_marked_and_limits_are_explained() {
    let (_view, mut browser, tab) = open_page();
    browser.evaluate(
        &tab,
        "window.press = (seconds, ripple, from = 1) => { for (let t = 0; t <= seconds; t += .016) markGains({...view.last, state: 'Armed', \
         time: from + t, numbers: {...view.last.numbers, wall: 0, depth: 1e-3, ripple}}); }; window.marks = () => tried.marks.map(m => m.buzzes).join()",
    );
    let marks = |browser: &mut Browser, press: &str| {
        browser.evaluate(&tab, &format!("(() => {{ tried.press = null; {press}; return marks(); }})()"))
    };
    assert_eq!(marks(&mut browser, "press(.25, .1)"), "", "too short a press leaves no mark");
    assert_eq!(marks(&mut browser, "press(.4, .1)"), "false", "quiet");
    assert_eq!(marks(&mut browser, "press(.4, 2, 9)"), "true", "a second press at the same gains buzzes");
    assert_eq!(
        marks(&mut browser, "press(.4, 2, 9); press(.4, .1, 9.4)"),
        "false",
        "the wall becomes quiet after a buzz"
    );
    browser.wait_until(&tab, "!$('forget').hidden");
    browser.evaluate(&tab, "$('explain').click()");
    browser.wait_until(&tab, "$('limits').textContent.includes('Stiffest stable wall') && $('limits').textContent.includes('ten times the rate')");
    let notice = browser.evaluate(&tab, "$('limits').innerText").as_str().unwrap().to_string();
    for words in ["no delay", "cut-off 100 Hz", "Hand: none", "Left out", "quiet at 8.70 kN/m"] {
        assert!(notice.contains(words), "{words}: {notice}");
    }
    assert!(!notice.contains("rigid transmissions"), "this device is rigid: {notice}");
    browser.evaluate(&tab, "$('limits').onkeydown(new KeyboardEvent('keydown', {key: 'Escape'}))");
    assert_eq!(browser.evaluate(&tab, "$('limits').hidden && $('explain').getAttribute('aria-expanded')"), "false");
    let spoken = browser.evaluate(&tab, "$('dot').textContent").as_str().unwrap().to_string();
    let stable = "8.70 kN/m, 80.0 N s/m, feed-forward washed out: predicted stable, tried: quiet; limit ";
    assert!(spoken.starts_with(stable), "{spoken}");
    // Moving the wall removes the marks.
    drag_the_wall(&mut browser, &tab);
    assert_eq!(marks(&mut browser, "press(.02, .1)"), "");
    assert_eq!(marks(&mut browser, "press(.4, .1)"), "false");
    browser.evaluate(&tab, "$('start-over').click(); window.then = view.hello");
    browser.wait_until(&tab, "view.hello !== then");
    assert_eq!(marks(&mut browser, "press(.02, .1)"), "", "starting over removes the marks");
    assert_eq!(browser.console_errors(), [""; 0]);
}

#[test]
fn a_click_beside_the_dot_changes_no_gains() {
    let (_view, mut browser, tab) = open_page();
    browser.hold_until(&tab, "document.body.dataset.state === 'Armed'");
    let beside = plane_place(&mut browser, &tab, 40.0, 15e3);
    browser.evaluate(&tab, "window.gains = JSON.stringify([view.walls[0].damping, view.walls[0].stiffness])");
    browser.send_mouse(&tab, "mousePressed", beside);
    browser.send_mouse(&tab, "mouseReleased", beside);
    browser.evaluate(&tab, "window.then = view.pictures");
    browser.wait_until(&tab, "view.pictures > then + 10");
    assert_eq!(
        browser.evaluate(&tab, "JSON.stringify([view.walls[0].damping, view.walls[0].stiffness]) === gains"),
        true,
        "only dragging the dot changes the gains"
    );
    browser.send_space(&tab, "keyUp");
}

#[test]
fn the_feed_forward_changes_while_the_mouse_presses_the_wall() {
    let (_view, mut browser, tab) = open_page();
    browser.hold_until(&tab, "document.body.dataset.state === 'Armed'");
    lead_into_the_wall(&mut browser, &tab);
    browser.hold_until(&tab, "view.last.numbers.force > 2 && view.last.numbers.depth > 0");
    // The ripple is known only after some time of contact.
    browser.hold_until(&tab, "now?.ripple > 0");
    browser.evaluate(&tab, "$('ff').click()");
    browser.wait_until(&tab, "view.walls[0].feed_forward === 'off' && $('anyway').hidden");
    // The scope shows the curve from before the click and the new one on the same axis, and the buzz frequency.
    browser.hold_until(&tab, "view.ghost?.mode === 'washout' && view.buzz > 55 && view.buzz < 95");
    browser.hold_until(
        &tab,
        r"/^Now off: [\d.]+ times louder than on\. Buzz: [67]\d Hz predicted, [67]\d measured\.$/.test($('ripple').textContent)",
    );
    browser.evaluate(&tab, "window.range = JSON.stringify(axes.rendered_n)");
    browser.evaluate(&tab, "$('ff-washout').click()");
    browser.wait_until(&tab, "view.walls[0].feed_forward === 'washout'");
    browser.hold_until(&tab, r"/^Now on: [\d.]+ times quieter than off\./.test($('ripple').textContent)");
    let keeps_range = "(r => axes.rendered_n.low <= r.low && axes.rendered_n.high >= r.high)(JSON.parse(window.range))";
    assert_eq!(browser.evaluate(&tab, keeps_range), true, "the axis keeps its range, so that a quiet wall looks quiet");
    // Pictures for a paper have a width in millimetres and letters of at least eight points.
    browser.evaluate(&tab, "view.hello.device = 'a & <b>'");
    for (what, millimetres) in [("stage", 85), ("plane", 85), ("scope", 170)] {
        let checks_graph = format!(
            "(() => {{ const svg = svgOf('{what}', {millimetres}), root = new DOMParser().parseFromString(svg, 'image/svg+xml').documentElement, \
             own = root.viewBox.baseVal.width / {millimetres} * 25.4 / 72; \
             return [root.tagName, root.getAttribute('width'), Math.min(...[...root.querySelectorAll('text')].map(t => t.getAttribute('font-size') / own)), \
             root.querySelectorAll('path').length > 5, /NaN|undefined/.test(svg), root.querySelector('title').textContent]; }})()"
        );
        let found = browser.evaluate(&tab, &checks_graph);
        assert_eq!((&found[0], &found[1]), (&Value::from("svg"), &Value::from(format!("{millimetres}mm"))), "{what}");
        assert!(found[2].as_f64().unwrap() > 7.99 && found[3] == true && found[4] == false, "{what}: {found}");
        assert!(found[5].as_str().unwrap().starts_with("a & <b>, 8.70 kN/m"), "{what}: {found}");
    }
    browser.evaluate(&tab, "$('off').click()");
    browser.wait_until(&tab, "document.body.dataset.state === 'Disarmed'");
    // While the motors are off, a wall can be dragged by its handle.
    browser.evaluate(&tab, "view.goal = null; $('let-go').click()");
    browser.wait_until(&tab, "view.last.hand === null");
    drag_the_wall(&mut browser, &tab);
    assert_eq!(browser.console_errors(), [""; 0]);
}

/// A link sets device, pose, walls and gains. A wrong link causes a notice and changes nothing.
#[test]
fn a_link_restores_device_pose_walls_and_gains() {
    let (view, mut browser, tab) = open_page();
    // With the motors on, the hand would move a tip in the wall out of it.
    browser.evaluate(&tab, "$('off').click()");
    browser.evaluate(&tab, "sendGains({ stiffness: 12345, damping: 60, feed_forward: 'full' })");
    browser.evaluate(&tab, "say({ do: 'start-over', pose: [2.2, 1.3] })");
    browser.wait_until(&tab, "view.last.q[0] > 2.199 && view.walls[0].stiffness === 8700");
    browser.evaluate(&tab, "sendGains({ stiffness: 12345, damping: 60, feed_forward: 'full' })");
    browser.evaluate(&tab, "say({ do: 'wall', wall: 0, point: [0.01, 0.15], normal: [0, 1] })");
    browser.wait_until(&tab, "view.walls[0].stiffness === 12345 && view.walls[0].values[4] === 1");
    let link = browser.evaluate(&tab, "$('copy').click(), link()").as_str().unwrap().to_string();
    browser.wait_until(
        &tab,
        "location.hash.includes('device=coupled-five-bar') && !$('notice').classList.contains('bad')",
    );
    let hash = link.split('#').nth(1).unwrap().to_string();
    assert!(!link.contains('?'), "a link must not contain the token: {link}");
    browser.evaluate(&tab, "$('take').click()");
    let other = browser.open(&format!("{}#{hash}", view.url), LAPTOP, 1.0);
    browser.bring_to_front(&other);
    let same = "window.view?.last && view.walls[0].stiffness === 12345 && view.walls[0].damping === 60 && view.walls[0].feed_forward === 'full' && \
                view.walls[0].values[4] === 1 && Math.abs(view.last.q[1] - 1.3) < 1e-3 && view.wanted === null";
    browser.wait_until(&other, same);
    for (page_errors, words) in [
        ("wall=1,2,sideways", "not one of off, full, washout"),
        ("wall=1,2,off,x,y", "numbers"),
        ("pose=1,2,3,4", "pose"),
        ("lesson=99", "lesson"),
        ("do=arm", "unknown part"),
        ("device=other", "s device other"),
        ("wall=1,1,off&wall=1,1,off", "2 walls"),
        ("wall=-5,1,off", "stiffness"),
    ] {
        browser.evaluate(&other, &format!("notice(''); location.hash = '{page_errors}'"));
        browser.wait_until(
            &other,
            &format!("$('notice').classList.contains('shown') && $('why').textContent.includes('{words}')"),
        );
    }
    // The notice stays until another link is opened.
    browser.evaluate(&other, "location.hash = 'pose=a'; location.reload()");
    browser.wait_until(&other, "window.view?.pictures > 10 && view.hello && $('why').textContent.includes('pose')");
    browser.evaluate(&other, "location.hash = 'pose=2.2,1.3'");
    browser.wait_until(&other, "!$('notice').classList.contains('shown')");
    // A lesson's link changes the device, too.
    browser.evaluate(&other, "location.hash = 'lesson=1'");
    browser.wait_until(&other, "view.hello?.scene === 'slow' && $('why').textContent.includes('Press into the wall')");
    assert_eq!(browser.console_errors(), [""; 0]);
}

/// Watches a page without reading: notes when the wall buzzes and glows, and when it is quiet afterwards, in seconds of
/// simulated time since the first picture, so that a busy computer has no effect.
const EYES: &str = "window.eyes = {}; setInterval(() => { const n = view.last?.numbers, mode = view.walls[0]?.feed_forward; if (!n) return; window.first ??= view.last.time; \
     const at = view.last.time - first; if (!view.fast || view.limited) return; if (mode === 'off' && n.ripple > 1 && n.power > GLOWS) eyes.buzz ??= at; \
     if (eyes.buzz && mode === 'washout' && now.settled && n.ripple < .2) eyes.cure ??= at; }, 20);";

/// The page shows the buzz and its cure by itself; at the first touch the user has it, wherever the hand is pulled.
#[test]
fn somebody_who_reads_nothing_sees_the_buzz_and_its_cure() {
    let view = View::start(&["--port", "sim"]);
    let mut browser = Browser::start();
    let tab = browser.open("about:blank", LAPTOP, 1.0);
    browser.bring_to_front(&tab);
    browser.call_page(
        &tab,
        "Page.addScriptToEvaluateOnNewDocument",
        json!({"source": format!("addEventListener('DOMContentLoaded', () => {{ {EYES} }})")}),
    );
    browser.call_page(&tab, "Page.navigate", json!({"url": view.url}));
    browser.wait_until(&tab, "window.eyes?.cure > 0");
    let cured = browser.evaluate(&tab, "eyes.cure").as_f64().unwrap();
    assert!(cured < 8.0, "{cured} s");
    assert_eq!(browser.evaluate(&tab, "touched"), false);
    browser.wait_until(&tab, r"/^Now on: \d\d+ times quieter than off\. Buzz: [67]\d Hz predicted, [67]\d measured\.$/.test($('ripple').textContent)");
    // Only six controls are in view besides More.
    let shown =
        "[...document.querySelectorAll('button, select, input')].filter(e => e.offsetParent).map(e => e.id).join()";
    assert_eq!(browser.evaluate(&tab, shown), "choice,rate,start-over,more,ff,stiffness,damping");
    // A wall has no handle in view, so that a pull beside the tip does not move it.
    let handle = place_on(
        &mut browser,
        &tab,
        "stage",
        "view.frame.toX(wallHandle(view.walls[0])[0])",
        "view.frame.toY(wallHandle(view.walls[0])[1])",
    );
    let wall = browser.evaluate(&tab, "window.then = view.last.time, JSON.stringify(view.walls[0].values)");
    browser.drag(&tab, handle, (handle.0 - 80.0, handle.1 + 60.0));
    browser.wait_until(&tab, "touched && view.last.time > then + .5");
    assert_eq!(browser.evaluate(&tab, "JSON.stringify(view.walls[0].values)"), wall);
    // Somebody pulls the tip sideways instead of inwards, and flips the switch twice.
    let tip = place_on(
        &mut browser,
        &tab,
        "stage",
        "view.frame.toX(view.last.geometry.tip[0])",
        "view.frame.toY(view.last.geometry.tip[1])",
    );
    browser.drag(&tab, tip, (tip.0 - 60.0, tip.1 + 110.0));
    browser.evaluate(&tab, "window.eyes = {}; if (view.walls[0].feed_forward !== 'off') $('ff').click()");
    browser.wait_until(&tab, "eyes.buzz > 0 && touched && sound !== null");
    browser.evaluate(&tab, "$('ff').click(); window.flipped = view.last.time - first");
    browser.wait_until(&tab, "eyes.cure > 0");
    let took = browser.evaluate(&tab, "eyes.cure - flipped").as_f64().unwrap();
    assert!(took < 4.0, "{took} s");
    browser.evaluate(&tab, "window.then = view.last.time");
    browser.wait_until(&tab, "view.last.time > then + 5");
    assert_eq!(browser.evaluate(&tab, "view.walls[0].feed_forward"), "washout", "the user has the switch");
    // At a limit of the motors nothing is stable, and nothing is compared.
    let limited = "(() => { const p = {...view.last, numbers: {...view.last.numbers, saturated: 1}}; compareRipple(p); drawPlane(); return [now.ripple, $('dot').textContent]; })()";
    let found = browser.evaluate(&tab, limited);
    assert!(
        found[0].is_null() && found[1].as_str().unwrap().contains("not rendered: motors at their limit"),
        "{found}"
    );
    assert_eq!(browser.console_errors(), [""; 0]);
}

/// *Start over* resets everything, and the page runs by itself again. A faster rate cures the buzz as well.
#[test]
fn start_over_resets_and_rate_and_device_change() {
    let (_view, mut browser, tab) = open_page();
    let walls = browser.evaluate(&tab, "JSON.stringify(view.walls)");
    browser.evaluate(&tab, "$('ff-full').click()");
    browser.wait_until(&tab, "view.walls[0].feed_forward === 'full'");
    browser.evaluate(&tab, "$('rate').value = 2000; $('rate').onchange()");
    browser.wait_until(&tab, "view.hello?.rate_hz === 2000 && view.plane && view.walls[0].feed_forward === 'full' && view.last.state === 'Armed'");
    browser.evaluate(&tab, "$('start-over').click()");
    let back = format!(
        "JSON.stringify(view.walls) === {walls} && view.last.hand === null && view.hello.rate_hz === 1000 && !touched"
    );
    browser.wait_until(&tab, &back);
    browser.wait_until(&tab, "Math.abs(view.last.numbers.depth + 0.010) < 1e-4");
    // The notice of a fault stays and shows its remedies.
    let faulty = "(() => { picture({...view.last, state: 'Fault', fault: 'x'}); const r = ['anew', 'clear', 'dismiss'].map(id => \
                  $('notice').contains($(id)) && $(id).offsetParent !== null); return r.join(); })()";
    assert_eq!(browser.evaluate(&tab, faulty), "true,true,false");
    browser.wait_until(&tab, "!$('notice').classList.contains('shown') && view.last.held");
    // The arrow keys move the hand, too. A hand that is put on its rail leaves the wall at once.
    browser.evaluate(
        &tab,
        "window.x = view.last.geometry.tip[0]; $('stage').onkeydown({key: 'ArrowRight', preventDefault() {}})",
    );
    browser.wait_until(&tab, "view.last.hand && Math.abs(view.last.hand.goal[0] - window.x - 2e-3) < 1e-4");
    browser.evaluate(&tab, "$('rail').checked = true; $('stage').onkeydown({key: 'ArrowUp', preventDefault() {}})");
    browser
        .wait_until(&tab, "Math.hypot(...wallPlace(RAIL.before).map((at, i) => at - view.last.hand.goal[i])) < 1e-6");
    browser.evaluate(&tab, "$('choice').value = 1; $('choice').onchange()");
    browser.wait_until(
        &tab,
        "view.hello?.device === 'haply-2diy' && view.last.state === 'Armed' && $('choice').selectedIndex === 1",
    );
    assert_eq!(browser.console_errors(), [""; 0]);
}

#[test]
fn a_single_sweep_waits_for_its_trigger() {
    let (_view, mut browser, tab) = open_page();
    browser.wait_until(&tab, "view.sweep && $('phase').textContent === 'rolling'");
    browser.evaluate(&tab, "window.rolled = view.sweep");
    browser.evaluate(
        &tab,
        "$('channel-a').value = 'distance_m'; $('edge').value = 'down'; $('level').value = '0'; \
         $('trigger').value = 'once'; $('trigger').onchange()",
    );
    // A sweep from before the change arrives late and is ignored.
    browser.evaluate(&tab, "numbers(window.rolled)");
    assert_eq!(browser.evaluate(&tab, "$('phase').textContent"), "waiting for the trigger");
    lead_into_the_wall(&mut browser, &tab);
    browser.wait_until(&tab, "view.sweep && view.sweep[1] === 3 && $('phase').textContent === 'one sweep'");
    browser.evaluate(&tab, "$('scope').style.maxHeight = '80px'");
    browser
        .wait_until(&tab, "$('scope').clientHeight === 80 && $('scope').height === Math.round(80 * devicePixelRatio)");
    browser.send_space(&tab, "keyUp");
    assert_eq!(browser.console_errors(), [""; 0]);
}

/// Counts the pixels of a palette colour in a square around a place of the drawn plane (m).
fn count_coloured(browser: &mut Browser, tab: &Tab, place: &str, colour: &str, half: u32) -> u64 {
    let count = format!(
        "(() => {{ const c = $('stage'), r = devicePixelRatio, p = {place}, k = c.getContext('2d'); k.save(); \
         const one = document.createElement('canvas').getContext('2d'); one.fillStyle = palette['{colour}'] || '#0d8a8a'; \
         one.fillRect(0, 0, 1, 1); const w = one.getImageData(0, 0, 1, 1).data; k.restore(); \
         const x = Math.round(view.frame.toX(p[0]) * r), y = Math.round(view.frame.toY(p[1]) * r); \
         const d = k.getImageData(x - {half}, y - {half}, 2 * {half}, 2 * {half}).data; let n = 0; \
         for (let i = 0; i < d.length; i += 4) if (d[i + 3] > 200 && Math.abs(d[i] - w[0]) + Math.abs(d[i + 1] - w[1]) + Math.abs(d[i + 2] - w[2]) < 24) n++; \
         return n; }})()"
    );
    browser.evaluate(tab, &count).as_u64().unwrap()
}

/// A spring is drawn from its anchor point or line to the tip, and so is the line.
#[test]
fn springs_of_the_scene_are_drawn() {
    let folder = Folder::new();
    // The line y = 0.15 above the tip, and a point to its right.
    let springs = "[[spring]]\npoint = [0.0, 0.15]\ndirection = [1.0, 0.0]\nstiffness = 250.0\ndamping = 1.0\n\n\
                   [[spring]]\npoint = [0.06, 0.10]\nstiffness = 100.0\ndamping = 1.0\n";
    let scene = folder.write("springs.toml", springs);
    let view = View::start(&[&shipped_path("haply-2diy.toml"), "--port", "sim", "--scene", &scene]);
    let mut browser = Browser::start();
    let tab = browser.open(&view.url, LAPTOP, 1.0);
    browser.wait_until(&tab, "window.view && view.pictures > 10 && document.body.dataset.role === 'command'");
    browser.evaluate(&tab, "theme(false); $('start-over').click(); stopped = true");
    browser.wait_until(&tab, "view.frame && view.pictures > 20");
    let tip = browser.evaluate(&tab, "view.last.geometry.tip").clone();
    let (x, y) = (tip[0].as_f64().unwrap(), tip[1].as_f64().unwrap());
    let mut page_state =
        |at: (f64, f64), half| count_coloured(&mut browser, &tab, &format!("[{}, {}]", at.0, at.1), "spring", half);
    assert!(page_state((x, 0.5 * (y + 0.15)), 8) > 10, "no spring between the line and the tip");
    assert!(page_state((x - 0.04, 0.15), 12) > 5, "the line of the spring is not drawn");
    assert!(page_state((0.5 * (x + 0.06), 0.5 * (y + 0.10)), 8) > 10, "no spring between the point and the tip");
    assert!(page_state((0.06, 0.10), 5) > 30, "the point is not drawn");
    assert_eq!(page_state((x - 0.04, 0.14), 6), 0, "something is drawn where no spring is");
    assert_eq!(browser.console_errors(), [""; 0]);
    if let Ok(folder) = std::env::var("HAPTIC_PICTURES") {
        let png = browser.save_picture(&tab, false);
        std::fs::write(format!("{folder}/view-spring.png"), png).unwrap();
    }
}

/// At every size the page fits and the key is visible.
#[test]
fn the_page_fits_a_phone_a_laptop_and_a_projector() {
    let (_view, mut browser, tab) = open_page();
    browser.hold_until(&tab, "document.body.dataset.state === 'Armed'");
    lead_into_the_wall(&mut browser, &tab);
    browser.hold_until(&tab, "view.last.numbers.force > 2");
    for (name, size, scale, dark) in [
        ("laptop", LAPTOP, 1.0, false),
        ("laptop-dark", LAPTOP, 1.0, true),
        ("phone", PHONE, 2.0, false),
        ("phone-dark", PHONE, 2.0, true),
        ("phone-turned", (PHONE.1, PHONE.0), 2.0, false),
        ("projector", PROJECTOR, 1.0, false),
    ] {
        browser.size(&tab, size, scale);
        browser.evaluate(&tab, &format!("theme({dark})"));
        let pictures = browser.evaluate(&tab, "view.pictures").as_u64().unwrap();
        browser.wait_until(&tab, &format!("view.pictures > {}", pictures + 20));
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
            let png = browser.save_picture(&tab, size == PHONE);
            std::fs::write(format!("{folder}/view-{name}.png"), png).unwrap();
        }
    }
}
