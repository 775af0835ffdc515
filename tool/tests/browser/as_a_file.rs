//! The same page as a file: no tool, no server. Tests that `cargo xtask test --deep browser` runs once it has made the file.

use super::devtools::{Browser, Tab};
use super::{LAPTOP, by_the_wall, drag_the_wall, lead_into_the_wall, on_plane};

pub fn path() -> String {
    std::env::var("HAPTIC_PLAYGROUND")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../target/playground/haptic-page.html").into())
}

fn opened() -> (Browser, Tab) {
    let mut browser = Browser::start();
    let tab = browser.open(&format!("file://{}", path()), LAPTOP, 1.0);
    browser.until(
        &tab,
        "window.view && view.pictures > 3 && view.plane !== null && document.body.dataset.role === 'command'",
    );
    browser.front(&tab);
    (browser, tab)
}

#[test]
fn as_a_file_it_is_alive_and_asks_nobody_for_anything() {
    let (mut browser, tab) = opened();
    let count = |browser: &mut Browser, what: &str| browser.evaluate(&tab, what).as_u64().unwrap();
    let (pictures, sweeps) = (count(&mut browser, "view.pictures"), count(&mut browser, "view.sweeps"));
    browser.until(&tab, &format!("view.pictures > {} && view.sweeps > {}", pictures + 20, sweeps + 10));
    browser.evaluate(&tab, "$('sound').click()");
    browser.until(&tab, "view.sounds > 5");
    assert_eq!(browser.evaluate(&tab, "view.hello.rows_hz === view.hello.rate_hz"), true, "every step is a row");
    // What takes a tool is not there.
    assert_eq!(browser.evaluate(&tab, "$('record').offsetParent"), serde_json::Value::Null);
    let own = format!("file://{}", path());
    let asked: Vec<String> =
        browser.requested().into_iter().filter(|url| *url != own && url != "about:blank").collect();
    assert!(asked.iter().all(|url| url.starts_with("data:") || url.starts_with("blob:null/")), "{asked:?}");
    assert_eq!(browser.complaints(), [""; 0]);
    // Nor could it: the page itself forbids it.
    browser.evaluate(
        &tab,
        "view.forbidden = []; addEventListener('securitypolicyviolation', e => view.forbidden.push(e.effectiveDirective)); \
         fetch('http://127.0.0.1:9/').catch(() => 0); new Image().src = 'http://127.0.0.1:9/';",
    );
    browser.until(&tab, "view.forbidden.includes('connect-src') && view.forbidden.includes('img-src')");
    println!("the simulation ran at {} of its time", browser.evaluate(&tab, "view.last.speed"));
}

#[test]
fn as_a_file_its_wall_buzzes_without_the_feed_forward_and_is_quiet_with_it() {
    let (mut browser, tab) = opened();
    let armed = "document.body.dataset.state === 'Armed'";
    browser.hold_until(&tab, armed);
    lead_into_the_wall(&mut browser, &tab);
    browser.hold_until(&tab, "view.last.numbers.force > 2 && view.last.numbers.depth > 0");
    // A click without the feed-forward is asked about first.
    browser.evaluate(&tab, "$('ff-off').click()");
    browser.until(&tab, "!$('anyway').hidden");
    browser.evaluate(&tab, "$('anyway').click()");
    browser.until(&tab, "view.walls[0].feed_forward === 'off' && document.body.dataset.stable === 'false'");
    // Each time anew from outside: where friction holds a quiet wall quiet, only the way in decides.
    let mut ripple = |mode: &str| {
        browser.evaluate(&tab, "view.from = view.last.time; (v => say({do: 'hand', at: [v[0] + .01 * v[3], v[1] + .01 * v[4]]}))(view.walls[0].values)");
        browser.hold_until(&tab, "view.last.time > view.from + 0.8");
        browser.evaluate(&tab, "$('beyond').checked = true; view.from = view.last.time; view.most = 0");
        browser.evaluate(&tab, &format!("$('ff-{mode}').click(); say({{do: 'hand', at: view.goal}})"));
        let pressed = format!(
            "view.walls[0].feed_forward === '{mode}' && view.last.time > view.from + 1.5 && view.last.numbers.force > 2 && \
             view.last.numbers.depth > 0"
        );
        browser.hold_until(&tab, &pressed);
        browser.evaluate(&tab, "view.last.numbers.ripple").as_f64().unwrap()
    };
    let (off, washout) = (ripple("off"), ripple("washout"));
    assert!(off > 0.4 && off > 4.0 * washout, "off {off} N, washed out {washout} N");
    println!("ripple: without the feed-forward {off} N, with it {washout} N");
    browser.space(&tab, "keyUp");
    browser.until(&tab, "document.body.dataset.state === 'Disarmed'");
    if let Ok(folder) = std::env::var("HAPTIC_PICTURES") {
        std::fs::write(format!("{folder}/playground.png"), browser.picture(&tab, false)).unwrap();
    }
    assert_eq!(browser.complaints(), [""; 0]);
}

#[test]
fn as_a_file_gains_and_walls_are_dragged_and_devices_chosen() {
    let (mut browser, tab) = opened();
    let (from, to) = (on_plane(&mut browser, &tab, 80.0, 8700.0), on_plane(&mut browser, &tab, 40.0, 10e3));
    browser.drag(&tab, from, to);
    browser.until(&tab, "Math.abs(view.walls[0].damping - 40) < 1 && Math.abs(view.walls[0].stiffness - 10e3) < 200");
    drag_the_wall(&mut browser, &tab);
    let count = browser.evaluate(&tab, "$('choice').length").as_u64().unwrap();
    assert!(count >= 5, "{count} devices");
    for choice in (0..count).rev() {
        let pictures = browser.evaluate(&tab, "view.pictures").as_u64().unwrap();
        browser.evaluate(
            &tab,
            &format!("$('choice').selectedIndex = {choice}; $('choice').dispatchEvent(new Event('change'))"),
        );
        browser.until(
            &tab,
            &format!(
                "view.hello && $('choice').value.startsWith(shown() + ':') && view.pictures > {} && \
                 document.body.dataset.role === 'command'",
                pictures + 10
            ),
        );
        assert_eq!(browser.evaluate(&tab, "$('notice').classList.contains('shown')"), false, "choice {choice}");
    }
    // A lesson's set-up, and a link to another device.
    let links = [("lesson=1", "hapkit-paddle"), ("device=haply-2diy/groove&pose=1.9,1.1", "haply-2diy")];
    for (link, device) in links {
        browser.evaluate(&tab, &format!("location.hash = '{link}'"));
        browser.until(
            &tab,
            &format!("view.hello?.device === '{device}' && view.last && view.wanted === null && view.pictures > 10"),
        );
    }
    browser.until(&tab, "$('choice').value.includes('groove') && Math.abs(view.last.q[0] - 1.9) < 1e-2");
    browser.evaluate(&tab, "location.hash = 'device=nothing'");
    browser.until(&tab, "$('why').textContent.includes('s device nothing: nothing was changed')");
    browser.evaluate(&tab, "notice(''); $('choice').selectedIndex = 0; $('choice').onchange()");
    browser.until(&tab, "view.hello?.smooth && view.last && view.frame && document.body.dataset.role === 'command'");
    // The demo is as it was in the beginning, and its hand comes to the mouse.
    assert_eq!(browser.evaluate(&tab, "view.walls[0].feed_forward"), "washout");
    let place = by_the_wall(&mut browser, &tab, 0.03);
    browser.mouse(&tab, "mousePressed", place);
    browser.mouse(&tab, "mouseReleased", place);
    browser.until(&tab, "view.last.hand !== null");
    assert_eq!(browser.complaints(), [""; 0]);
}
