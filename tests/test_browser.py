"""docs/browser.md: the module and the playground have the bits of the package, under node and in Chromium."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import chromium
import pytest
from click.testing import CliRunner
from docs.site import look
from playwright.sync_api import Page
from web import build

from truestroke import AdaptiveController, Dynamics, Mode, SettingError, cli, export_json
from truestroke.plant import Change, PlantSettings

ROOT = Path(__file__).parents[1]
SIZES = ("--sample-rate", "2000", "--stroke", "30", "--voltage-limits", "-0.6", "3.6")
STAGE = Dynamics(
    sample_rate=2000.0,
    modes=(Mode(frequency=300.0, damping=0.02, share=0.9), Mode(frequency=600.0, damping=0.03, share=0.1)),
    amplifier_bandwidth=400.0,
    dead_time=5e-4,
)
LAWS: dict[str, Callable[[], AdaptiveController]] = {
    "default": lambda: AdaptiveController(**build.STACK),
    "paper": lambda: AdaptiveController.paper(**build.STACK),
    "stage": lambda: AdaptiveController(**build.STACK, dynamics=STAGE, hum=50.0),
}


def needed(program: str, package: str) -> str:
    """The path of a program; where it is absent, the test is skipped, but not in CI."""
    found = shutil.which(program)
    if not found:
        assert not os.environ.get("CI"), f"CI needs {program}: apt-get install {package}"
        pytest.skip(f"no {program} here; Debian: apt-get install {package}")
    return found


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `web/build.py` writes."""
    folder = tmp_path_factory.mktemp("web")
    build.write(folder)
    return folder


def node(folder: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [needed("node", "nodejs"), *map(str, arguments)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600, check=False)


def checked(built: Path, *files: Path) -> list[str]:
    done = node(ROOT, "web/check.mjs", built / "truestroke.wasm", *files)
    assert done.stderr == ""
    return done.stdout.splitlines()


def test_it_is_small_and_asks_for_nothing(built: Path) -> None:
    assert (built / "truestroke.wasm").stat().st_size < 200_000
    asked = "WebAssembly.Module.imports(new WebAssembly.Module(require('fs').readFileSync('truestroke.wasm'))).length"
    assert node(built, "-p", asked).stdout == "0\n"


def test_controller_and_stack_have_the_bits_of_the_desk(built: Path, tmp_path: Path) -> None:
    settings = PlantSettings(change=Change(time=0.3, gain=0.9, hysteresis=1.2), resonance=700.0)
    files = [export_json(law(), tmp_path / f"{name}.json", ticks=1000) for name, law in LAWS.items()]
    for name in ("default", "paper"):
        files.append(tmp_path / f"{name}-loop.json")
        files[-1].write_text(json.dumps(build.looped(LAWS[name](), settings, 1000)))
    assert checked(built, *files) == ["passed: 1000 of 1000 ticks have the same bits"] * len(files)


def test_the_check_fails_where_a_setting_differs(built: Path, tmp_path: Path) -> None:
    file = export_json(LAWS["default"](), tmp_path / "c.json", ticks=200)
    content = json.loads(file.read_text())
    content["members"]["kalman.outlier"] *= 0.01
    file.write_text(json.dumps(content))
    done = node(ROOT, "web/check.mjs", built / "truestroke.wasm", file)
    assert done.stdout.startswith("FAILED: ")
    assert done.returncode == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("members.unknown = 1", "the module has no unknown[0]"),
        ("members.thresholds = Array(99).fill(1)", "the module has no thresholds[32]"),
        ("members.stroke = -1", "stroke, measurement_limit, smoothing or trim: out of range"),
        ("members.stroke = 'wide'", "stroke[0] = wide: must be a number"),
        ("members['kalman.outliers'] = NaN", "must be a number"),
        ("after = (c) => c.command(NaN, 0)", "z_d = NaN um: must be finite"),
        ("after = (c) => c.start(0, 1e6)", "z = 1000000 um under 0 V: out of reach"),
        ("after = (c) => c.restore(new Uint8Array(3))", "3 bytes: a saved controller of this module has"),
        (
            "after = (c) => c.restore(new Controller(c.module, { ...members, stroke: 20 }).save())",
            "saved with stroke = 20: must be 30, as here",
        ),
    ],
)
def test_bad_input_is_named(change: str, words: str, built: Path, tmp_path: Path) -> None:
    file = export_json(LAWS["paper"](), tmp_path / "c.json", ticks=100)
    text = f"""
        import {{ readFileSync }} from "node:fs";
        import {{ Controller, Module }} from "{built / "truestroke.js"}";
        const {{ members }} = JSON.parse(readFileSync("{file}", "utf8"));
        let after = () => 0;
        {change};
        after(new Controller(await Module.load(), members));
    """
    done = node(built, "--input-type=module", "-e", text)
    assert done.returncode == 1
    assert words in done.stderr


def test_a_saved_controller_goes_on_with_the_same_bits(built: Path, tmp_path: Path) -> None:
    file = export_json(LAWS["default"](), tmp_path / "c.json", ticks=300)
    text = f"""
        import {{ readFileSync }} from "node:fs";
        import {{ Controller, Module }} from "{built / "truestroke.js"}";
        const {{ members, recorded }} = JSON.parse(readFileSync("{file}", "utf8"));
        const module = await Module.load();
        let controller = new Controller(module, members);
        let same = 0;
        recorded.rows.forEach(([z_d, v, a, volts, z], k) => {{
            if (k === 150) {{
                const saved = controller.save();
                controller = new Controller(module, members);
                controller.restore(saved);
            }}
            same += controller.command(z_d, v, a) === volts;
            controller.adapt(z);
        }});
        console.log(same);
    """
    assert node(built, "--input-type=module", "-e", text).stdout == "300\n"


def test_the_example_of_the_page(built: Path) -> None:
    page = (ROOT / "docs/browser.md").read_text()
    (script,) = re.findall(r"```js\n(.*?)```", page, flags=re.DOTALL)
    (printed,) = re.findall(r"prints `(.*)`", page)
    (built / "own.mjs").write_text(script)
    export_json(LAWS["default"](), built / "controller.json", ticks=100)
    done = node(built, "own.mjs")
    assert (done.stdout, done.stderr) == (printed + "\n", "")


def opened(address: str, virtual: int) -> subprocess.CompletedProcess[str]:
    """The page after so many ms of the browser's own time; the module is compiled beside it, in time of the machine."""
    with tempfile.TemporaryDirectory() as profile:
        options = [*chromium.QUIET.split(), f"--user-data-dir={profile}", "--enable-logging=stderr"]
        options += [f"--virtual-time-budget={virtual}", "--force-prefers-reduced-motion", "--dump-dom"]
        command = [chromium.found(), *options, address]
        return subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)


def test_the_playground_has_the_bits_of_the_desk_from_a_file(built: Path) -> None:
    state = "#controller=truestroke&motion=scan&speed=20&noise=1e9&hysteresis=x"  # the last two are not possible
    address = (built / "playground.html").as_uri() + state
    pages = (opened(address, virtual) for virtual in (2000, 20_000, 60_000))
    done = next((page for page in pages if "data-bits" in page.stdout), None)
    assert done is not None
    assert "CONSOLE" not in done.stderr
    assert 'data-bits="800/800"' in done.stdout
    assert re.search(r'id="figures">truestroke: rms error [\d.]+ nm', done.stdout)
    assert ">200 nm</output>" in done.stdout
    assert ">33 %</output>" in done.stdout
    assert "http" not in re.sub(r"(?s)<script.*?</script>", "", done.stdout)


@pytest.fixture
def phone(built: Path) -> Iterator[Page]:
    """The playground, from its file, on the screen of a phone."""
    with look.chromium() as browser:
        screen: Any = {"viewport": {"width": 360, "height": 740}, "has_touch": True, "is_mobile": True}
        page = browser.new_context(**screen).new_page()
        page.set_default_timeout(look.PATIENCE)
        page.goto((built / "playground.html").as_uri())
        page.wait_for_function("document.getElementById('figures').textContent.startsWith('no compensation: rms')")
        yield page


TAPPED = {  # a control, what the address says of it then, and what the page shows of it
    "[value=truestroke]": ("controller=truestroke", "$('figures').startsWith('truestroke: rms error')"),
    "[value=sine]": ("motion=sine", "$('loop-title') === 'Displacement over desired displacement'"),
    "[name=held]": ("held=1", "$('flags').includes('held')"),
    "[name=change]": ("change=1", "Number.parseFloat($('figures').split('rms error ')[1]) > 0"),
    "[name=dead]": ("dead=1", "$('flags').includes('rejected')"),
    "[value=scan]": ("motion=scan", "$('loop-title').startsWith('Image') && shades() > 50"),
    "[value=paper]": ("controller=paper", "$('figures').startsWith('the paper')"),
    "[value=none]": ("", "$('figures').startsWith('no compensation')"),
    "[value=waves]": ("", "$('loop-title').startsWith('Displacement')"),
    "#run": ("", "$('run') === 'Run'"),
    "#restart": ("", "$('figures').includes('rms error')"),
    "#defaults": ("", "location.hash === ''"),
}
READ = """
window.$ = (id) => document.getElementById(id).textContent;
window.shades = () => {
  const picture = document.getElementById("loop").getContext("2d");
  return new Set(picture.getImageData(90, 20, 250, 250).data).size;
};
"""


def test_a_finger_presses_every_control_of_the_playground(phone: Page) -> None:
    phone.evaluate(READ)
    for control, (address, seen) in TAPPED.items():
        phone.locator(control).tap()
        phone.wait_for_function(f"location.hash.includes({address!r}) && ({seen})")
    controls = "#controls input:not([type=range]), .laws input, #controls button"
    assert phone.locator(controls).count() == len(TAPPED)
    assert look.too_wide(phone) == []
    assert look.inaccessible(phone) == []


def test_the_keyboard_and_the_address_move_every_slider(phone: Page) -> None:
    sliders = phone.locator("input[type=range]").all()
    assert len(sliders) == 6
    for slider in sliders:
        before = float(slider.input_value())
        slider.press("ArrowLeft")
        phone.wait_for_function(f"location.hash.includes('{slider.get_attribute('name')}=')")
        assert float(slider.input_value()) < before
        assert slider.get_attribute("aria-valuetext") == slider.locator("xpath=..").locator("output").text_content()
    sent = phone.evaluate("location.hash")
    phone.locator("#defaults").press("Enter")
    assert phone.evaluate("location.hash") == ""
    phone.evaluate(f"location.hash = {sent!r}")  # a colleague opens it
    for slider in sliders:
        shown = f"document.querySelector('[name={slider.get_attribute('name')}]').value"
        phone.wait_for_function(f"{sent!r}.includes('{slider.get_attribute('name')}=' + {shown})")


def test_the_frame_on_the_first_page_shows_all_of_the_playground(built: Path) -> None:
    """Two bars to scroll with, one in the other, trap a finger."""
    block = re.search(r'<div class="playground">.*?</div>', (ROOT / "docs/site/index.md").read_text(), flags=re.DOTALL)
    assert block
    (built / "first.html").write_text(f"<!doctype html><style>iframe {{ width: 100% }}</style>{block[0]}")
    with look.chromium() as browser:
        for width in (360, 800):
            page = browser.new_page(viewport={"width": width, "height": 740})
            page.set_default_timeout(look.PATIENCE)
            page.goto((built / "first.html").as_uri())
            whole = "document.documentElement.scrollHeight <= innerHeight"
            page.frames[1].wait_for_function(f"innerHeight > 900 && {whole}")
            page.close()


def test_what_cannot_be_exported_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="double: the module computes in double precision"):
        export_json(AdaptiveController(**build.STACK, precision="single"), tmp_path / "c.json")
    with pytest.raises(SettingError, match="ticks"):
        export_json(LAWS["paper"](), tmp_path / "c.json", ticks=1)
    assert not (tmp_path / "c.json").exists()


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> tuple[int, str]:
        done = CliRunner().invoke(cli.main, ["export", "json", *SIZES, *arguments])
        return done.exit_code, done.output

    assert call("--output", "c.json", "--json") == (0, '{"file": "c.json"}\n')
    assert call("--output", "c.json", "--ticks", "100")[0] == 0  # one of ours
    assert len(json.loads(Path("c.json").read_text())["recorded"]["rows"]) == 100
    code, printed = call("--output", "d.json", "--history", "20")
    assert (code, "--history is one of `export c`" in printed) == (2, True)
    Path("mine.json").write_text("{}")
    assert call("--output", "mine.json")[0] == 1
    assert Path("mine.json").read_text() == "{}"
