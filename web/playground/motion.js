/**
 * Desired motions, in um, um/s and um/s^2, with a phase that goes on when the frequency changes.
 * @module motion
 */

const RISE = 0.5; // s: how long a motion takes to its full size
const WAVES = [
  [1, 0.55],
  [0.382, 0.3],
  [0.618, 0.15],
]; // frequencies over the highest, and shares of the swing
const SHARP = 0.97; // of the turns of a scan: 1 is a triangle

/** A factor from 0 to 1 and its two derivatives, smooth to the second. */
function risen(t) {
  const s = Math.min(t / RISE, 1);
  return [
    s ** 3 * (10 - 15 * s + 6 * s * s),
    (30 * s * s * (1 - s) ** 2) / RISE,
    (60 * s * (1 - s) * (1 - 2 * s)) / RISE ** 2,
  ];
}

/** value and derivatives of a(t) b(t) */
const product = ([a, a1, a2], [b, b1, b2]) => [a * b, a1 * b + a * b1, a2 * b + 2 * a1 * b1 + a * b2];

/** A sine of this phase (rad) and rate (rad/s). */
const sine = (phase, w, size) => [size * Math.sin(phase), size * w * Math.cos(phase), -size * w * w * Math.sin(phase)];

/** A triangle with round turns between -1 and 1: asin(k sin(phase)) / asin(k). */
function triangle(phase, w) {
  const [s, c] = [SHARP * Math.sin(phase), SHARP * Math.cos(phase)];
  const root = Math.sqrt(1 - s * s);
  const whole = Math.asin(SHARP);
  return [Math.asin(s) / whole, (w * c) / root / whole, (w * w * s * (c * c - root * root)) / root ** 3 / whole];
}

/** The motion of one axis. */
export class Motion {
  /** @param {number} middle um @param {number} swing um, half of peak to peak */
  constructor(middle, swing) {
    Object.assign(this, { middle, swing });
    this.reset();
  }

  reset() {
    this.t = 0;
    this.phase = -Math.PI / 2;
  }

  /**
   * The next tick.
   * @param {"waves" | "sine" | "scan"} kind
   * @param {number} frequency Hz
   * @param {number} tick s
   * @returns {[number, number, number]}
   */
  next(kind, frequency, tick) {
    const w = 2 * Math.PI * frequency;
    let swing;
    if (kind === "waves") {
      swing = WAVES.map(([f, share]) => sine(this.phase * f, w * f, share)).reduce((a, b) => a.map((x, i) => x + b[i]));
    } else {
      swing = kind === "scan" ? triangle(this.phase, w) : sine(this.phase, w, 1);
    }
    const now = product(risen(this.t), [this.middle + this.swing * swing[0], this.swing * swing[1], this.swing * swing[2]]);
    this.t += tick;
    this.phase += w * tick;
    return now;
  }
}

/** Standard normal numbers from a seed. */
export function normal(seed) {
  let state = seed >>> 0;
  const uniform = () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let x = Math.imul(state ^ (state >>> 15), state | 1);
    x ^= x + Math.imul(x ^ (x >>> 7), x | 61);
    return ((x ^ (x >>> 14)) >>> 0) / 2 ** 32;
  };
  return () => Math.sqrt(-2 * Math.log(1 - uniform())) * Math.cos(2 * Math.PI * uniform());
}
