/**
 * The controller and the simulated stack of truestroke, in WebAssembly: the bits of the desk.
 *
 * Displacement in um, velocity in um/s, acceleration in um/s^2, voltage in V at the D/A converter. Settings are what
 * `truestroke export json` writes.
 * @module truestroke
 */

/**
 * @typedef {number | boolean | string} Entry A number ("Infinity" is one as text) or a truth value.
 * @typedef {Object<string, Entry | Entry[] | Entry[][]>} Members Of the kernel's settings, by name; what is missing is 0.
 */

const CHUNK = 65536; // bytes of a page of WebAssembly
const ALIGNED = 16; // bytes
const LONGEST = 256; // bytes of the name of a member

/** A module that was loaded: memory and functions. */
export class Module {
  /** @param {WebAssembly.Instance} instance Of `truestroke.wasm`. */
  constructor(instance) {
    /** @type {any} */
    this.call = instance.exports;
    this.free = this.call.heap();
  }

  /**
   * Compiles the module.
   * @param {BufferSource} [bytes] Of `truestroke.wasm`; by default those within this file.
   * @returns {Promise<Module>}
   */
  static async load(bytes = within()) {
    return new Module((await WebAssembly.instantiate(bytes, {})).instance);
  }

  /** Memory for so many bytes, all 0. It stays: make a controller once and `reset` it. */
  take(bytes) {
    const at = Math.ceil(this.free / ALIGNED) * ALIGNED;
    this.free = at + bytes;
    const missing = this.free - this.call.memory.buffer.byteLength;
    if (missing > 0) this.call.memory.grow(Math.ceil(missing / CHUNK));
    return at;
  }

  /** Numbers in the memory. Take the view anew after each call that makes something: the memory may have moved. */
  doubles(at, count) {
    return new Float64Array(this.call.memory.buffer, at, count);
  }

  /** The text at an address. */
  text(at) {
    const bytes = new Uint8Array(this.call.memory.buffer, at);
    return new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
  }

  /**
   * Writes settings into a struct.
   * @param {(at: number, name: number, row: number, column: number, value: number) => number} set Of the struct.
   * @param {number} at Where it is.
   * @param {Members} members
   */
  write(set, at, members) {
    const place = this.name ?? (this.name = this.take(LONGEST));
    for (const [name, value] of Object.entries(members)) {
      const text = new TextEncoder().encode(`${name}\0`);
      if (text.length > LONGEST) throw new RangeError(`settings have no member ${name}`);
      new Uint8Array(this.call.memory.buffer, place, text.length).set(text);
      [value].flat().forEach((row, i) =>
        [row].flat().forEach((entry, j) => {
          const number = Number(entry);
          if (Number.isNaN(number)) throw new TypeError(`${name}[${i}] = ${entry}: must be a number`);
          if (!set(at, place, i, j, number)) throw new RangeError(`the module has no ${name}[${i}]: settings of another version`);
        }),
      );
    }
  }
}

/** @returns {Uint8Array} */
function within() {
  if (typeof TRUESTROKE_WASM === "undefined") throw new Error("no bytes: pass those of truestroke.wasm");
  return Uint8Array.from(atob(TRUESTROKE_WASM), (c) => c.charCodeAt(0));
}

/** Numbers that must be finite where they are not NaN for "not known". */
function finite(name, value, unit) {
  if (!Number.isFinite(value)) throw new RangeError(`${name} = ${value} ${unit}: must be finite`);
}

/** The controller: in each tick `command`, then `adapt` with what was measured. */
export class Controller {
  /**
   * @param {Module} module
   * @param {Members} members Of ts_settings: `members` of `truestroke export json`.
   */
  constructor(module, members) {
    this.module = module;
    this.members = members;
    const call = module.call;
    this.settings = module.take(call.controller_settings_bytes());
    this.at = module.take(call.controller_bytes());
    this.volts = module.take(8);
    module.write(call.controller_set, this.settings, members);
    this.reset();
  }

  /** Back to the start: nothing is learned. */
  reset() {
    const status = this.module.call.controller_init(this.at, this.settings);
    if (status !== 0) throw new RangeError(`${this.module.text(this.module.call.status_setting(status))}: out of range`);
  }

  /** Starts with an actuator at rest at `z` um under `volts`. */
  start(volts, z) {
    if (this.module.call.controller_start(this.at, volts, z) !== 0)
      throw new RangeError(`z = ${z} um under ${volts} V: out of reach, or the voltage is beyond its limits`);
  }

  /**
   * The voltage for a desired displacement, within limits and slew.
   * @param {number} z_d um
   * @param {number} zdot_d um/s
   * @param {number} [zddot_d] um/s^2; NaN where it is not known
   * @param {number} [strain_d] um: what the hysteresis should give so that the stage moves as desired; the same
   * @returns {number} V
   */
  command(z_d, zdot_d, zddot_d = NaN, strain_d = NaN) {
    finite("z_d", z_d, "um");
    finite("zdot_d", zdot_d, "um/s");
    this.module.call.controller_follow(this.at, z_d, zdot_d, zddot_d, strain_d, this.volts);
    return this.module.doubles(this.volts, 1)[0];
  }

  /**
   * Learns from a measurement; NaN is none.
   * @param {number} z um
   * @param {number} [ago] Commands that were given after the one that it belongs to.
   * @returns {boolean} Whether it was used.
   */
  adapt(z, ago = 0) {
    return this.module.call.controller_adapt(this.at, z, ago) === 0;
  }

  /** Stops or resumes learning; commands go on. */
  hold(on) {
    this.module.call.controller_hold(this.at, on ? 1 : 0);
  }

  /** Flags of the last tick; `flags` of `truestroke export json` names the bits. */
  get flagBits() {
    return this.module.call.controller_flags(this.at);
  }

  /** Measured less expected displacement of the last tick, um. */
  get innovation() {
    return this.module.call.controller_innovation(this.at);
  }

  /** What was learned, um/V and the units of the other terms. */
  get weights() {
    const call = this.module.call;
    return this.module.doubles(call.controller_weights(this.at), call.controller_parameters(this.at)).slice();
  }

  /** Partial sums of the weights of the plays at the present velocity, as the inverse used them, um/V. */
  get slopes() {
    const call = this.module.call;
    return this.module.doubles(call.controller_slopes(this.at), call.controller_plays(this.at)).slice();
  }

  /** All of it, to go on from later, and the settings that it is of. */
  save() {
    const state = new Uint8Array(this.module.call.memory.buffer, this.at, this.module.call.controller_bytes());
    const text = new TextEncoder().encode(JSON.stringify(this.members));
    const saved = new Uint8Array(state.length + text.length);
    saved.set(state);
    saved.set(text, state.length);
    return saved;
  }

  /** Goes on from what a controller with the same settings saved, to the same bits; others are refused by name. */
  restore(bytes) {
    const size = this.module.call.controller_bytes();
    if (bytes.length <= size) throw new RangeError(`${bytes.length} bytes: a saved controller of this module has more than ${size}`);
    const saved = JSON.parse(new TextDecoder().decode(bytes.subarray(size)));
    for (const name of Object.keys({ ...saved, ...this.members })) {
      const [there, here] = [saved, this.members].map((members) => JSON.stringify(members[name] ?? 0));
      if (there !== here) throw new RangeError(`saved with ${name} = ${there}: must be ${here}, as here`);
    }
    new Uint8Array(this.module.call.memory.buffer, this.at, size).set(bytes.subarray(0, size));
    this.module.call.controller_point(this.at, this.settings);
  }
}

/** The simulated stack: converters, amplifier, hysteresis, creep, resonance, drift, noise. */
export class Plant {
  /**
   * @param {Module} module
   * @param {Members} members Of ts_plant_settings: `plant` of `truestroke export json`.
   */
  constructor(module, members) {
    this.module = module;
    this.settings = module.take(module.call.plant_settings_bytes());
    this.at = module.take(module.call.plant_bytes());
    this.samples = Number(members.samples_per_tick);
    this.noise = module.take(8 * this.samples);
    this.volts = module.take(24);
    this.write(members);
    this.reset();
  }

  write(members) {
    if (Number(members.samples_per_tick) !== this.samples) throw new RangeError("samples_per_tick cannot change");
    this.module.write(this.module.call.plant_set, this.settings, members);
  }

  /** At rest at time 0. */
  reset() {
    this.module.call.plant_init(this.at, this.settings);
  }

  /** Other settings while it moves: the voltage, the plays, what has crept and the motion of the stage stay. */
  change(members) {
    this.write(members);
    this.module.call.plant_change(this.at, this.settings);
  }

  /** Ticks so far. */
  get tick() {
    return this.module.call.plant_tick(this.at);
  }

  /**
   * Holds a voltage for a tick.
   * @param {number} volts V
   * @param {ArrayLike<number>} noise Standard normal numbers, one for each sample.
   * @returns {{measured: number, truth: number}} um, means over the tick
   */
  exchange(volts, noise) {
    finite("volts", volts, "V");
    this.module.doubles(this.noise, this.samples).set(noise);
    const place = this.volts;
    this.module.doubles(place, 1)[0] = volts;
    this.module.call.plant_run(this.at, place, this.noise, place + 8, place + 16, 1);
    const [, measured, truth] = this.module.doubles(place, 3);
    return { measured, truth };
  }
}
