/**
 * The pictures, on canvas: axes with units, colours of the page's theme.
 * @module charts
 */

const FONT = "12px system-ui, sans-serif";
const COLOURS = ["text", "grid", "desired", "true", "wrong"];
const MARGIN = { left: 46, right: 10, top: 10, bottom: 34 };

/** Steps 1, 2, 5 times a power of ten, about `count` of them from low to high. */
function steps(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const first = Math.ceil(low / step - 1e-9);
  const last = Math.floor(high / step + 1e-9);
  return Array.from({ length: last - first + 1 }, (_, i) => Number(((first + i) * step).toPrecision(12)));
}

/** A canvas with two axes. They stand on a canvas of their own behind it, and are drawn again only where they change. */
export class Chart {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.front = canvas.getContext("2d");
    this.back = document.createElement("canvas").getContext("2d");
    canvas.before(this.back.canvas);
    this.draw = this.back;
    this.#measure();
    new ResizeObserver(() => this.#measure()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#measure());
  }

  /** Size and colours, which cost a layout of the page: not in each frame. */
  #measure() {
    const style = getComputedStyle(this.canvas);
    this.colours = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`)]));
    this.ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.size = [this.canvas.clientWidth, this.canvas.clientHeight];
    const [width, height] = this.size.map((length) => Math.max(1, Math.round(length * this.ratio)));
    for (const { canvas } of [this.front, this.back]) Object.assign(canvas, { width, height });
    this.shown = "";
  }

  /** Begins a picture: ranges, titles of the axes, whether it is a square. */
  begin([x0, x1], [y0, y1], xTitle, yTitle, square = false) {
    const [width, height] = this.size;
    const [top, bottom] = [MARGIN.top, height - MARGIN.bottom];
    const left = MARGIN.left;
    const right = Math.min(width - MARGIN.right, square ? left + bottom - top : Infinity);
    this.box = { left, right, top, bottom };
    this.x = (v) => left + ((v - x0) / (x1 - x0)) * (right - left);
    this.y = (v) => bottom - ((v - y0) / (y1 - y0)) * (bottom - top);
    const wanted = [x0, x1, y0, y1, xTitle, yTitle, square].join();
    if (wanted !== this.shown) {
      this.draw = this.back;
      this.#cleared();
      this.#axes([x0, x1], [y0, y1], xTitle, yTitle);
      this.shown = wanted;
    }
    this.draw = this.front;
    this.#cleared();
  }

  #cleared() {
    this.draw.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.draw.clearRect(0, 0, ...this.size);
  }

  colour(name) {
    return this.colours[name];
  }

  #axes([x0, x1], [y0, y1], xTitle, yTitle) {
    const d = this.draw;
    const { left, right, top, bottom } = this.box;
    d.font = FONT;
    d.lineWidth = 1;
    d.strokeStyle = this.colour("grid");
    d.fillStyle = this.colour("text");
    d.textAlign = "center";
    d.textBaseline = "top";
    for (const v of steps(x0, x1, Math.max(2, (right - left) / 90))) {
      this.#line(this.x(v), top, this.x(v), bottom);
      d.fillText(String(v), this.x(v), bottom + 4);
    }
    d.fillText(xTitle, (left + right) / 2, bottom + 19);
    d.textAlign = "right";
    d.textBaseline = "middle";
    for (const v of steps(y0, y1, Math.max(2, (bottom - top) / 45))) {
      this.#line(left, this.y(v), right, this.y(v));
      d.fillText(String(v), left - 5, this.y(v));
    }
    d.save();
    d.translate(10, (top + bottom) / 2);
    d.rotate(-Math.PI / 2);
    d.textAlign = "center";
    d.fillText(yTitle, 0, 0);
    d.restore();
  }

  #line(x0, y0, x1, y1) {
    this.draw.beginPath();
    this.draw.moveTo(x0, y0);
    this.draw.lineTo(x1, y1);
    this.draw.stroke();
  }

  /** A curve through points, within the box. */
  curve(count, x, y, colour, width = 1.5, dash = []) {
    this.#within(colour, width, dash, (d) => {
      for (let i = 0; i < count; i++) d.lineTo(this.x(x(i)), this.y(y(i)));
    });
  }

  /** A curve of many points over ascending places: of each column of pixels the lowest and the highest. */
  trace(count, x, y, colour, width) {
    this.#within(colour, width, [], (d) => {
      let [column, low, high] = [NaN, 0, 0];
      const put = () => {
        if (Number.isNaN(column)) return;
        d.lineTo(column, this.y(low));
        if (high !== low) d.lineTo(column, this.y(high));
      };
      for (let i = 0; i < count; i++) {
        const [at, value] = [Math.round(this.x(x(i))), y(i)];
        if (at === column) {
          low = Math.min(low, value);
          high = Math.max(high, value);
          continue;
        }
        put();
        [column, low, high] = [at, value, value];
      }
      put();
    });
  }

  #within(colour, width, dash, path) {
    const d = this.draw;
    const { left, right, top, bottom } = this.box;
    d.save();
    d.beginPath();
    d.rect(left, top, right - left, bottom - top);
    d.clip();
    d.strokeStyle = this.colour(colour);
    d.lineWidth = width;
    d.lineJoin = "bevel";
    d.setLineDash(dash);
    d.beginPath();
    path(d);
    d.stroke();
    d.restore();
  }

  /** A square picture of values from 0 to 1 in the box, row by row from below; NaN is left out. */
  image(values, size) {
    const { left, right, top, bottom } = this.box;
    this.pixels ??= new ImageData(size, size);
    this.picture ??= Object.assign(document.createElement("canvas"), { width: size, height: size }).getContext("2d");
    for (let i = 0; i < values.length; i++) {
      const at = 4 * ((size - 1 - Math.floor(i / size)) * size + (i % size));
      this.pixels.data.fill(Math.round(30 + 210 * values[i]), at, at + 3);
      this.pixels.data[at + 3] = Number.isNaN(values[i]) ? 0 : 255;
    }
    this.picture.putImageData(this.pixels, 0, 0);
    this.draw.imageSmoothingEnabled = false;
    this.draw.drawImage(this.picture.canvas, left, top, right - left, bottom - top);
  }
}
