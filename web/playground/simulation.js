/**
 * One or two simulated stacks under a controller, tick by tick.
 * @module simulation
 */
import { Controller, Plant } from "../truestroke.js";
import { Motion, normal } from "./motion.js";

const MIDDLE = 14; // um
const SWING = 12; // um
export const LINES = 48; // of a scan from its first line to its last
const CHANGE = { change_gain: 0.85, change_hysteresis: 1.3 };

/** One axis: motion, controller, stack. */
class Axis {
  constructor(module, data, seed) {
    this.plant = new Plant(module, data.plant);
    this.controllers = Object.fromEntries(
      Object.entries(data.controllers).map(([name, settings]) => [name, new Controller(module, settings.members)]),
    );
    this.sensitivity = data.sensitivity; // um/V
    this.motion = new Motion(MIDDLE, SWING);
    this.seed = seed;
  }

  restart(state, members) {
    this.plant.change(members);
    this.plant.reset();
    this.motion.reset();
    this.random = normal(this.seed);
    this.controller = this.controllers[state.controller]; // none: a straight line
    this.controller?.reset();
    this.noise = new Float64Array(this.plant.samples);
  }

  tick(state, frequency, seconds) {
    const [z_d, zdot_d, zddot_d] = this.motion.next(state.motion, frequency, seconds);
    const volts = this.controller ? this.controller.command(z_d, zdot_d, zddot_d) : z_d / this.sensitivity;
    const flags = this.controller?.flagBits ?? 0;
    for (let i = 0; i < this.noise.length; i++) this.noise[i] = this.random();
    const { measured, truth } = this.plant.exchange(volts, this.noise);
    this.controller?.adapt(state.dead ? NaN : measured);
    return { z_d, volts, measured, truth, flags: flags | (this.controller?.flagBits ?? 0) };
  }
}

/** The axes, and the last ticks of the first of them. */
export class Simulation {
  constructor(module, data, kept) {
    this.data = data;
    this.axes = [new Axis(module, data, 1), new Axis(module, data, 2)];
    this.seconds = 1 / data.controllers.truestroke.sample_rate;
    this.kept = kept; // ticks
    this.desired = new Float64Array(kept);
    this.truth = new Float64Array(kept);
    this.image = new Float32Array(LINES * LINES);
  }

  /** The stack that the sliders describe. */
  members(state) {
    const ofStack = Object.entries(this.data.sliders).filter(([, { to }]) => to !== null);
    const chosen = Object.fromEntries(ofStack.map(([name, { to }]) => [name, state[name] * to]));
    const changed = state.change ? { ...CHANGE, change_tick: this.axes[0].plant.tick } : {};
    return { ...this.data.plant, ...chosen, ...changed };
  }

  /** From rest; nothing is learned. */
  restart(state) {
    this.ticks = 0;
    this.flags = 0;
    this.image.fill(NaN);
    this.column = 0; // of the image, in the tick before
    const members = { ...this.members(state), ...(state.change ? { change_tick: 0 } : {}) };
    for (const axis of this.axes) axis.restart(state, members);
    this.hold(state);
  }

  /** The stack becomes another one while it moves. */
  change(state) {
    for (const axis of this.axes) axis.plant.change(this.members(state));
  }

  hold(state) {
    for (const axis of this.axes) axis.controller?.hold(state.held);
  }

  /** So many ticks further. */
  run(state, ticks) {
    const [x, y] = this.axes;
    for (let i = 0; i < ticks; i++) {
      const now = x.tick(state, state.speed, this.seconds);
      this.flags |= now.flags;
      this.desired[this.ticks % this.kept] = now.z_d;
      this.truth[this.ticks % this.kept] = now.truth;
      this.ticks += 1;
      if (state.motion === "scan") this.#expose(now, y.tick(state, state.speed / (2 * LINES), this.seconds));
    }
  }

  /** Points of the image up to where the stage should be now: the grating where it is. */
  #expose(x, y) {
    const place = ({ z_d }) => Math.round(((z_d - MIDDLE) / (2 * SWING) + 0.5) * (LINES - 1));
    const [column, row] = [place(x), place(y)];
    if (column >= 0 && row >= 0 && column < LINES && row < LINES) {
      const step = Math.sign(this.column - column);
      for (let at = column; ; at += step) {
        this.image[row * LINES + at] = grating(x.truth, y.truth);
        if (step === 0 || at + step === this.column) break;
      }
    }
    this.column = Math.min(Math.max(column, 0), LINES - 1);
  }

  /** Flags of all ticks since they were asked for last, as bits. */
  flagsSince() {
    const since = this.flags;
    this.flags = 0;
    return since;
  }

  /** Root mean square and largest error of the last `ticks`, um. */
  errors(ticks) {
    const count = Math.min(ticks, this.ticks, this.kept);
    let [sum, most] = [0, 0];
    for (let k = this.ticks - count; k < this.ticks; k++) {
      const error = this.truth[k % this.kept] - this.desired[k % this.kept];
      sum += error * error;
      most = Math.max(most, Math.abs(error));
    }
    return { rms: Math.sqrt(sum / Math.max(count, 1)), most };
  }
}

/** Height of squares of 3 um with smooth edges, 0 to 1. */
function grating(x, y) {
  const wave = Math.sin((2 * Math.PI * x) / 6) * Math.sin((2 * Math.PI * y) / 6);
  return 0.5 + 0.5 * Math.tanh(3 * wave);
}
