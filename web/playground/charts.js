/**
 * The pictures, on canvas: axes with units, colours of the page's theme.
 * @module charts
 */

const FONT = "12px system-ui, sans-serif";
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

/** A canvas with two axes. */
export class Chart {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.draw = canvas.getContext("2d");
  }

  /** Begins a picture: ranges, titles of the axes, whether it is a square. */
  begin([x0, x1], [y0, y1], xTitle, yTitle, square = false) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const { clientWidth, clientHeight } = this.canvas;
    const [width, height] = [Math.round(clientWidth * ratio), Math.round(clientHeight * ratio)];
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    const d = this.draw;
    d.setTransform(ratio, 0, 0, ratio, 0, 0);
    d.clearRect(0, 0, clientWidth, clientHeight);
    const [top, bottom] = [MARGIN.top, clientHeight - MARGIN.bottom];
    const left = MARGIN.left;
    const right = Math.min(clientWidth - MARGIN.right, square ? left + bottom - top : Infinity);
    this.box = { left, right, top, bottom };
    this.x = (v) => left + ((v - x0) / (x1 - x0)) * (right - left);
    this.y = (v) => bottom - ((v - y0) / (y1 - y0)) * (bottom - top);
    this.#axes([x0, x1], [y0, y1], xTitle, yTitle);
  }

  colour(name) {
    return getComputedStyle(this.canvas).getPropertyValue(`--${name}`);
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
    const d = this.draw;
    const { left, right, top, bottom } = this.box;
    d.save();
    d.beginPath();
    d.rect(left, top, right - left, bottom - top);
    d.clip();
    d.strokeStyle = this.colour(colour);
    d.lineWidth = width;
    d.lineJoin = "round";
    d.setLineDash(dash);
    d.beginPath();
    for (let i = 0; i < count; i++) d.lineTo(this.x(x(i)), this.y(y(i)));
    d.stroke();
    d.restore();
  }

  /** A square picture of values from 0 to 1 in the box; NaN is left out. */
  image(values, size) {
    const { left, right, top, bottom } = this.box;
    const [w, h] = [(right - left) / size, (bottom - top) / size];
    for (let i = 0; i < values.length; i++) {
      if (Number.isNaN(values[i])) continue;
      const grey = Math.round(30 + 210 * values[i]);
      this.draw.fillStyle = `rgb(${grey} ${grey} ${grey})`;
      this.draw.fillRect(left + (i % size) * w, bottom - (Math.floor(i / size) + 1) * h, w + 0.6, h + 0.6);
    }
  }
}
