/**
 * Recorded runs of the desk, once more: how many commands have the same bits.
 * @module replay
 */
import { Controller, Plant } from "./truestroke.js";

/** Columns of numbers, from the base64 of their little-endian doubles. */
function numbers(base64) {
  const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  return Float64Array.from({ length: bytes.length / 8 }, (_, i) => view.getFloat64(8 * i, true));
}

/**
 * The run within a file of `truestroke export json`: desired motion and measurements go in, commands must come out.
 * @returns {{same: number, ticks: number}}
 */
export function replayed(module, settings) {
  const controller = new Controller(module, settings.members);
  controller.start(settings.safe_voltage, 0);
  let same = 0;
  for (const [z_d, zdot_d, zddot_d, volts, measured] of settings.recorded.rows) {
    same += Object.is(controller.command(z_d, zdot_d, zddot_d) + 0, volts + 0);
    controller.adapt(measured);
  }
  return { same, ticks: settings.recorded.rows.length };
}

/**
 * A run of controller and simulated stack: motion and noise go in, commands and measurements must come out.
 * @returns {{same: number, ticks: number}}
 */
export function looped(module, run) {
  const controller = new Controller(module, run.members);
  const plant = new Plant(module, run.plant);
  const motion = numbers(run.motion); // z_d, zdot_d, zddot_d, volts, measured of each tick
  const noise = numbers(run.noise);
  const ticks = motion.length / 5;
  let same = 0;
  for (let k = 0; k < ticks; k++) {
    const [z_d, zdot_d, zddot_d, expected, seen] = motion.subarray(5 * k, 5 * k + 5);
    const volts = controller.command(z_d, zdot_d, zddot_d);
    const { measured } = plant.exchange(volts, noise.subarray(k * plant.samples, (k + 1) * plant.samples));
    controller.adapt(measured);
    same += Object.is(volts + 0, expected + 0) && Object.is(measured + 0, seen + 0);
  }
  return { same, ticks };
}
