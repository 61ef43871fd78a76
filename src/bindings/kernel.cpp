// Python's view of the C kernel: one class, compiled once for double and once for float.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "asymmetry.h"
#include "dispatch.h"
#include "loops.h"
#include "native.h"
#include "settings.h"
#include "status.h"
#include "truestroke.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace {

#define TS_QUOTED(x) #x
#define TS_TEXT(x) TS_QUOTED(x)

template <typename T> using Vector = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// Python has checked the values, the kernel checks them again.
ts_settings settings_from(const nb::dict &d) {
    ts_settings s{};
    Reader read(d);
#define MEMBER(name, member) read(name, s.member);
#include "ts_settings.inc"
#undef MEMBER
    read.finish();
    return s;
}

void require_finite(const char *name, double value, const char *unit) {
    if (!std::isfinite(value))
        throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " " + unit +
                                    ": must be finite");
}

template <typename T> nb::object copy_of(const T *data, std::vector<size_t> shape) {
    size_t size = 1;
    for (size_t n : shape) size *= n;
    T *owned = new T[size];
    std::copy(data, data + size, owned);
    nb::capsule owner(owned, [](void *p) noexcept { delete[] static_cast<T *>(p); });
    return nb::cast(nb::ndarray<nb::numpy, T>(owned, shape.size(), shape.data(), owner));
}

// What a tick leaves behind, by name: `visit(name, first entry, count)` for each array. One list serves saving and
// restoring, so that they cannot differ.
template <typename Controller, typename Visit> void each_array(Controller &c, Visit visit) {
    size_t m = static_cast<size_t>(c.parameters), n = static_cast<size_t>(c.settings->plays);
    size_t triangle = static_cast<size_t>(TS_TRIANGLE(c.parameters));
    size_t creeps = static_cast<size_t>(c.settings->terms[TS_CREEP]), ways = static_cast<size_t>(c.settings->terms[TS_DUHEM]);
    visit("weights", &c.w[0], m);
    visit("bumpless", &c.bumpless, 1);
    visit("handed", &c.handed, 1);
    visit("integral", &c.integral, 1);
    visit("y_d", &c.y_d, 1);
    visit("fastest", &c.fastest, 1);
    visit("slopes", &c.slopes[0], n);
    visit("play", &c.now.play[0], n);
    visit("creep", &c.now.creep[0], creeps);
    visit("duhem", &c.now.duhem[0], ways);
    visit("history_volts", &c.x[0], TS_HISTORY);
    visit("history_motion", &c.motion[0].z_d, TS_HISTORY * sizeof(ts_motion) / sizeof(ts_real));
    visit("history_limited", &c.limited[0], TS_HISTORY);
    visit("answered", &c.answered, 1);
    visit("lagged_play", &c.lagged.play[0], n);
    visit("lagged_creep", &c.lagged.creep[0], creeps);
    visit("lagged_duhem", &c.lagged.duhem[0], ways);
    visit("lagged_ticks", &c.lagged.ticks, 1);
    visit("regressor", &c.u[0], m);
    visit("innovation", &c.innovation, 1);
    visit("z_before", &c.z_before, 1);
    visit("predicted_before", &c.predicted_before, 1);
    visit("resolution", &c.resolution, 1);
    visit("beyond", &c.beyond, 1);
    visit("hold", &c.hold, 1);
    visit("flags", &c.flags.saturated, sizeof c.flags / sizeof(bool));
    visit("counters", &c.counters.commands, sizeof c.counters / sizeof(uint64_t));
    if (c.settings->sensor.share > 0 || c.settings->sensor.lag > 0) {
        visit("sensor_before", &c.sensor.before[0], m);
        visit("sensor_lagged", &c.sensor.lagged[0], m);
    }
    if (c.settings->law == TS_LAW_RLS) {
        visit("covariance_factor", &c.law.rls.U[0], triangle);
        visit("covariance_diagonal", &c.law.rls.D[0], m);
        visit("covariance_trace", &c.law.rls.trace, 1);
        return;
    }
    auto &k = c.law.kalman;
    visit("covariance", &k.P[0], triangle);
    visit("filtered_once", &k.u1[0], m);
    visit("filtered", &k.u[0], m);
    visit("measured_once", &k.y1, 1);
    visit("measured", &k.y, 1);
    visit("covariance_times_regressor", &k.Pu[0], m);
    visit("innovation_variance", &k.variance, 1);
    visit("noise", &k.sigma, 1);
    visit("ringing", &k.ringing, 1);
    visit("innovation_before", &k.innovation1, 1);
    visit("innovation_before_that", &k.innovation2, 1);
    visit("change", &k.change, 1);
    visit("usual", &k.usual, 1);
    visit("innovation_power", &k.power, 1);
    visit("innovation_power_at_change", &k.at_change, 1);
    visit("filter", &k.filter, 1);
    visit("disturbance", &k.disturbance, 1);
    visit("load", &k.load, 1);
    visit("caution", &k.caution, 1);
    visit("since_change", &k.since_change, 1);
    visit("spikes", &k.spikes, 1);
    visit("since_return", &k.since_return, 1);
    visit("started", &k.started, 1);
    visit("pending", &k.pending, 1);
    visit("changed", &k.changed, 1);
    visit("outgrown", &k.outgrown, 1);
    auto &r = c.ringing;
    visit("ringing_regressor", &r.u[0], m);
    visit("ringing_measured", &r.y, 1);
    visit("ringing_error", &r.error[0], 2);
    visit("ringing_once", &r.once, 1);
    visit("ringing_twice", &r.twice[0], 2);
    visit("ringing_power", &r.power, 1);
    visit("ringing_started", &r.started, 1);
    visit("rings", &r.rings, 1);
    auto &o = c.oscillation;
    visit("error_fast", &o.fast, 1);
    visit("error_slow", &o.slow, 1);
    visit("error_slower", &o.slower, 1);
    visit("error_between", &o.h, 1);
    visit("error_before", &o.error, 1);
    visit("mean_speed", &o.speed, 1);
    visit("mean_acceleration", &o.acceleration, 1);
    visit("rate_before", &o.zdot_d, 1);
    visit("oscillation_time", &o.time, 1);
    visit("half_wave_peak", &o.peak, 1);
    visit("half_wave_steepest", &o.steepest, 1);
    visit("half_wave_peaks", &o.peaks[0], TS_HALF_WAVES);
    visit("half_wave_lengths", &o.lengths[0], TS_HALF_WAVES);
    visit("half_wave_sign", &o.sign, 1);
    visit("half_wave_length", &o.length, 1);
    visit("half_waves_regular", &o.regular, 1);
    visit("half_wave_missed", &o.missed, 1);
    visit("oscillation_started", &o.started, 1);
    visit("oscillation_found", &o.found, 1);
    auto &d = c.dynamics;
    auto &f = c.found;
    if (c.settings->law == TS_LAW_KALMAN) {
        visit("found", &f.known, 1);
        visit("found_sections", &f.sections, 1);
        visit("found_section", &f.section[0][0], 4);
        visit("found_direct", &f.direct[0], 3);
        visit("found_dead", &f.dead, 1);
        visit("found_notch", &f.notch[0], 3);
        visit("found_quiet", &f.quiet[0], 3);
        visit("found_tap", &f.tap[0], TS_TAPS);
        visit("found_lead", &f.lead[0], 2);
        visit("found_amplifier", &f.amplifier, 1);
        visit("slower", &c.slower[0], TS_SLOWER);
        visit("found_since", &c.stage.since, 1);
        visit("found_failed", &c.stage.failed, 2);
        visit("given_doubt", &c.stage.doubt, 1);
        visit("given_doubted", &c.stage.doubted, 1);
        visit("widest_motion", &c.stage.widest, 2);
        visit("stage_sections", &d.section[0][0], sizeof d.section / sizeof(ts_real));
        visit("stage_strain", &d.strain[0], TS_HISTORY);
        visit("stage_measured", &d.z[0], 2);
        visit("stage_modes", &d.mode[0][0], sizeof d.mode / sizeof(ts_real));
        visit("stage_innovation", &d.innovation[0], 2);
        visit("stage_ticks", &d.ticks, 1);
        visit("stage_started", &d.started, 1);
        visit("stage_stands", &d.stands, 1);
        for (int i = 0; i < TS_TAPS - 1; i++) visit(("stage_tap_" + std::to_string(i)).c_str(), &d.tap[i][0], m);
        for (int i = 0; i < 2 * c.settings->dynamics.others; i++)
            visit(("stage_rest_" + std::to_string(i)).c_str(), &d.rest[i / 2][i % 2][0], m);
    }
    visit("feedback", &c.feedback.sum, 1);
    visit("feedback_alarms", &c.feedback.alarms, 1);
    visit("feedback_paused", &c.feedback.paused, 1);
    visit("feedback_state", &c.feedback.state[0][0], sizeof c.feedback.state / sizeof(ts_real));
    visit("feedback_damping", &c.feedback.damping[0], 12);
    visit("hum", &c.hum.turn[0][0], offsetof(ts_hum_state, ear) / sizeof(ts_real));
    for (int i = 0; i <= TS_EARS; i++) { // the last one listens beyond the resonance
        auto &ear = i < TS_EARS ? c.hum.ear[i] : c.hum.beyond;
        visit(("ear_" + std::to_string(i)).c_str(), &ear.centre, 2 + offsetof(ts_tone, block) / sizeof(ts_real));
        visit(("ear_ticks_" + std::to_string(i)).c_str(), &ear.tone.block, 5);
        visit(("ear_of_error_" + std::to_string(i)).c_str(), &ear.of_error, 1);
    }
    for (int i = 0; i < 2 * (c.settings->hum.lines + TS_HEARD); i++) {
        visit(("hum_regressor_" + std::to_string(i)).c_str(), &c.hum.regressor[i / 2][i % 2][0], m);
        visit(("hum_measurement_" + std::to_string(i)).c_str(), &c.hum.measurement[i / 2][i % 2], 1);
    }
    auto &g = c.stage;
    visit("resonance", &g.resonance, 1);
    visit("inertia", &g.inertia, 1);
    visit("smoothing", &g.smoothing, 1);
    visit("rest", &g.rest, 1);
    visit("weights_age", &g.age, 1);
    visit("weights_newer", &g.newer[0], m);
    visit("weights_older", &g.before.older[0], m);
    visit("growth", &g.before.growth.ticks, sizeof g.before.growth / sizeof(ts_real));
    auto &v = c.resonance;
    visit("resonance_search", &v.centre, offsetof(ts_resonance, settling) / sizeof(ts_real));
    visit("resonance_ticks", &v.settling, 5);
    visit("resonance_turns", &v.strange, 2);
    visit("tone", &v.tone.step[0], offsetof(ts_tone, block) / sizeof(ts_real));
    visit("tone_ticks", &v.tone.block, 5);
    visit("resonance_plays", &c.shown[0], TS_SHOWN);
    visit("resonance_rate", &c.rate, 1);
    visit("candidate", &c.candidate.frequency, sizeof c.candidate / sizeof(ts_real));
    visit("guard", &c.guard.low, (offsetof(ts_guard, ticks) - offsetof(ts_guard, low)) / sizeof(ts_real));
    visit("guard_windows", &c.guard.ticks, (offsetof(ts_guard, kept) - offsetof(ts_guard, ticks)) / sizeof(int));
    visit("guard_found", &c.guard.kept, (offsetof(ts_guard, lost) - offsetof(ts_guard, kept)) / sizeof(bool) + 1);
    visit("guard_errors", &c.guard.errors.first, 3);
    visit("guard_errors_counted", &c.guard.errors.counted, 1);
    visit("guard_missed", &c.guard.missed.first, 3);
    visit("guard_missed_counted", &c.guard.missed.counted, 1);
    visit("kept_first", &c.kept.first[0], m);
    visit("kept_weights", &c.kept.w[0], m);
    visit("kept_aside", &c.kept.aside[0], m);
    visit("kept_covariance", &c.kept.P[0], static_cast<size_t>(TS_PACKED(c.parameters)));
    visit("kept_noise", &c.kept.sigma, 1);
    visit("kept_stage", &c.kept.filter, 4);
    visit("kept_found", &c.kept.oscillated, 4);
    visit("recall", &c.kept.watch.recall.low, offsetof(ts_recall, missed.counted) / sizeof(ts_real));
    visit("recall_ticks", &c.kept.watch.recall.missed.counted, 1);
}

// What no run leaves behind; the entry is named.
struct Inconsistent : std::invalid_argument {
    Inconsistent(const char *name, const std::string &bound)
        : std::invalid_argument(std::string("state entry ") + name + ": must be " + bound) {}
};

void require_range(const char *name, double value, double low, double high) {
    if (value >= low && value <= high) return;
    auto text = [](double x) { return std::to_string(static_cast<long long>(x)); };
    throw Inconsistent(name, "from " + text(low) + " to " + text(high));
}

void require_all(const char *name, bool holds, const char *bound) {
    if (!holds) throw Inconsistent(name, bound);
}

// The counters are ticks of one run: none is ahead of the one that it is part of.
void check_counters(const ts_controller &c) {
    const ts_counters &n = c.counters;
    constexpr uint64_t most = uint64_t{1} << 62; // 73 million years at 2 kHz
    bool good = n.commands <= most && n.rejected <= most && n.saturated <= n.commands && n.projected <= n.commands &&
                n.slewed <= n.commands && n.oscillating <= n.commands && n.restored <= n.commands && n.adaptations <= n.commands && n.changed <= n.adaptations;
    require_all("counters", good, "the counts of one run: none above that of the commands, changed not above adaptations");
    require_all("lagged_ticks", c.lagged.ticks <= n.commands && n.commands - c.lagged.ticks <= TS_HISTORY,
                "at most the commands that were counted, and at most " TS_TEXT(TS_HISTORY) " less");
    require_range("answered", c.answered, 0, 2 * TS_HISTORY);
    require_range("beyond", c.beyond, 0, TS_BEYOND);
    const ts_dynamics &f = c.found, &given = c.settings->dynamics, &g = f.known ? f : given;
    auto stable = [](const ts_real *a) { return a[1] < 1 && a[1] > -1 && a[0] < 1 + a[1] && a[0] > -1 - a[1]; };
    bool timely = given.known ? f.dead == given.dead : f.dead >= 0 && f.dead <= TS_MOST_DEAD;
    require_all("found", !f.known || (f.sections == 1 && timely && stable(f.section[0] + 2)), "a stage of one stable mode");
    require_all("found_amplifier", !f.known || (f.amplifier >= 0 && f.amplifier < 1), "a share from 0 to below 1");
    require_all("feedback_damping", !f.known || stable(c.feedback.damping + 3), "a stable filter");
    // The law comes as much later as the dead time; that of a found stage may just have changed.
    uint64_t dead = static_cast<uint64_t>(g.dead), ticks = c.dynamics.ticks, late = ticks - c.lagged.ticks;
    bool follows = f.known && !given.known ? c.lagged.ticks <= ticks && late <= TS_MOST_DEAD
                                           : c.lagged.ticks == (ticks > dead ? ticks - dead : 0) || (f.known && late == 0);
    require_all("stage_ticks", !g.known || (ticks <= n.commands && follows),
                "the lagged_ticks and the stage's dead time");
}

// Plays are within their thresholds of the voltage that they saw.
void check_plays(const ts_settings &s, const char *name, const ts_real *play) {
    ts_real rounding = sizeof(ts_real) > 4 ? static_cast<ts_real>(1e-9) : static_cast<ts_real>(1e-3);
    for (int i = 0; i < s.plays; i++) {
        ts_real scale = std::abs(play[0]) + s.thresholds[i];
        require_all(name, std::abs(play[i] - play[0]) <= s.thresholds[i] + rounding * scale,
                    "play states, each within its threshold of the first");
    }
}

// Rounding may take a variance below 0 by a share of the prior's; not by more.
void check_variance(const ts_controller &c, const char *name, ts_real variance, int i) {
    ts_real rounding = std::sqrt(std::numeric_limits<ts_real>::epsilon());
    require_all(name, variance >= -rounding * c.settings->prior[TS_PACKED(i) + i], "of variances of 0 or more");
}

void check_covariance(const ts_controller &c, const char *name, const ts_real *P) {
    for (int i = 0; i < c.parameters; i++) {
        const ts_real *row = P + TS_ROW(i);
        check_variance(c, name, row[i], i);
        for (int j = i - i % TS_LANES; j < i; j++) require_all(name, row[j] == P[TS_ROW(j) + i], "symmetric");
        for (int j = c.parameters; j < static_cast<int>(TS_PADDED(i + 1)); j++)
            require_all(name, row[j] == 0, "0 beyond the last parameter");
    }
}

void check_guard(const ts_controller &c) {
    const ts_guard &g = c.guard;
    require_all("guard", g.high >= g.low && g.ringing >= 0 && g.error >= 0 && g.best >= 0 && g.failed >= 0 && g.span >= 0 && g.swung >= 0 && g.promised >= 0 && g.entered >= 0,
                "a range and errors of 0 or more");
    require_all("guard_windows", g.ticks >= 0 && g.held >= 0 && g.held < INT32_MAX / 2 &&
                                 g.bad >= 0 && g.bad < INT32_MAX / 2 && g.small >= 0 && g.small < INT32_MAX / 2 && g.swings >= 0 && g.swings < INT32_MAX / 2 && g.good >= 0 && g.good < INT32_MAX / 2 && g.pause >= 0 &&
                                 g.ticks < INT32_MAX / 8 && g.wait >= TS_FIRST_WAIT && g.wait <= TS_LONGEST_WAIT,
                "counts of 0 or more, and a wait of " TS_TEXT(TS_FIRST_WAIT) " to " TS_TEXT(TS_LONGEST_WAIT));
    require_all("guard_errors", g.errors.square >= 0, "a sum of squares of 0 or more");
    require_all("guard_errors_counted", g.errors.counted >= 0 && g.errors.counted <= g.ticks, "0 to the ticks of the window");
    require_all("guard_missed", g.missed.square >= 0, "a sum of squares of 0 or more");
    require_all("guard_missed_counted", g.missed.counted >= 0 && g.missed.counted <= g.ticks, "0 to the ticks of the window");
    require_all("given_doubt", c.stage.doubt >= 0, "0 or more");
    require_all("given_doubted", c.stage.doubted >= 0, "0 or more");
    require_all("widest_motion", c.stage.widest >= 0, "0 or more");
    require_all("caution", c.law.kalman.caution >= 0, "0 or more");
    require_all("kept_noise", c.kept.sigma >= 0, "0 or more");
    require_all("kept_stage", c.kept.filter >= 0 && c.kept.filter <= 1 && (c.kept.filter > 0 || !g.lost) && c.kept.smoothing >= 0 &&
                              c.kept.smoothing < 1 && c.kept.resonance >= 0 && c.kept.resonance <= 1 && c.kept.inertia >= 0,
                "a filter of at most 1, a smoothing below 1, a resonance of at most 1, an inertia of 0 or more");
    require_all("recall", c.kept.watch.recall.missed.square >= 0 && (!c.guard.kept || c.kept.watch.recall.high >= c.kept.watch.recall.low), "a range and a sum of squares of 0 or more");
    require_all("recall_ticks", c.kept.watch.recall.missed.counted >= 0 && c.kept.watch.recall.missed.counted < INT32_MAX / 8, "0 or more");
    for (int i = 0; i < c.parameters; i++)
        check_variance(c, "kept_covariance", c.kept.P[TS_PACKED(i) + i], i);
}

// Cycles per tick; 0: none is looked for.
ts_real lowest_resonance(const ts_controller &c) {
    return TS_LOWEST_RESONANCE * c.settings->oscillation.tick;
}

void check_tone(const char *name, const char *ticks, const ts_tone &t, bool begun) {
    bool counts = t.block >= 0 && t.ticks >= 0 && t.blocks >= 0 && t.passed >= 0 && t.turns >= 0;
    require_all(ticks, counts && t.block < INT32_MAX / 2 && t.ticks <= t.block && (!begun || t.block >= 8), "counts of 0 or more, of a block that has not ended");
    require_all(name, t.power[0] >= 0 && t.power[1] >= 0 && t.last >= t.first && t.first >= 0, "a mean square of 0 or more, and turns in their order");
}

void check_resonance(const ts_controller &c) {
    const ts_resonance &r = c.resonance;
    bool sought = r.known == 0 || r.known >= static_cast<ts_real>(0.99) * lowest_resonance(c);
    bool good = sought && r.centre >= 0 && r.centre < 1 && r.known >= 0 && r.known < 1 && r.variance >= 0 && r.swept >= 0 && r.swept < 1 && r.motion >= 0 && r.power >= 0 && r.speed >= 0 && r.change >= 0 && r.error >= 0 && r.load >= 0 && r.load_at >= 0 && r.load_at < 1 && (r.load == 0 || r.load_at > 0);
    for (int i = 0; i < TS_RESONANCE; i++) good = good && r.sum[TS_PACKED(i) + i] >= 0;
    for (int i = 0; i < TS_MEASURED; i++) good = good && r.of_noise[TS_PACKED(i) + i] >= 0;
    require_all("resonance_search", good, "frequencies that are looked for, and sums of squares of 0 or more");
    check_tone("tone", "tone_ticks", r.tone, r.ticks > 0);
    bool begun = r.ticks == 0 || (r.centre > 0 && r.window > 0 && r.ticks < r.settling + r.window);
    require_all("resonance_ticks", r.ticks >= 0 && r.settling >= 0 && r.settling < INT32_MAX / 2 && r.window >= 0 && r.window < INT32_MAX / 2 && begun && r.windows >= 0 && r.windows <= 1000 && r.pointed >= 0 && r.pointed <= TS_MOST_POINTED,
                "counts of 0 or more, of a window that has not ended");
}

void check_kalman(const ts_controller &c) {
    const ts_kalman &k = c.law.kalman;
    auto not_negative = [](const char *name, ts_real value) { require_all(name, value >= 0, "0 or more"); };
    not_negative("innovation_variance", k.variance);
    not_negative("noise", k.sigma);
    not_negative("load", k.load);
    not_negative("ringing", k.ringing);
    not_negative("ringing_power", c.ringing.power);
    require_range("change", k.change, 0, 100);
    require_range("usual", k.usual, 0, 100);
    for (int i = 0; i < TS_LINES; i++) {
        const ts_real *turn = c.hum.turn[i];
        ts_real length = turn[0] * turn[0] + turn[1] * turn[1];
        require_all("hum", length > static_cast<ts_real>(0.99) && length < static_cast<ts_real>(1.01) && c.hum.over[i] >= 0, "phasors of length 1, and times of 0 or more");
    }
    require_all("hum", c.hum.unexplained.square >= 0, "a sum of squares of 0 or more");
    for (const auto &load : c.hum.heard) require_all("hum", load.line[2] >= 0 && load.announced >= 0 && load.age >= 0 && (load.beyond == 0 || load.beyond == 1), "frequencies, amplitudes and times of 0 or more");
    for (int i = 0; i <= TS_EARS; i++) {
        const ts_ear &e = i < TS_EARS ? c.hum.ear[i] : c.hum.beyond;
        std::string name = "ear_" + std::to_string(i), ticks = "ear_ticks_" + std::to_string(i);
        require_all(name.c_str(), e.centre >= 0 && e.centre < 1 && e.power >= 0, "a frequency and a sum of squares of 0 or more");
        require_range(("ear_of_error_" + std::to_string(i)).c_str(), e.of_error, 0, 1);
        check_tone(name.c_str(), ticks.c_str(), e.tone, e.centre > 0);
    }
    ts_real lowest = lowest_resonance(c); // the law waits for a period of a stage that was found
    if (c.found.known && c.stage.resonance < lowest) lowest = c.stage.resonance;
    int longest_wait = lowest > 0 ? static_cast<int>(std::min(1 / lowest, static_cast<ts_real>(INT32_MAX / 2))) + 1 : 0;
    require_range("since_change", k.since_change, -longest_wait, INT32_MAX);
    require_range("spikes", k.spikes, 0, INT32_MAX);
    require_range("since_return", k.since_return, 0, TS_RETURN_EVERY);
    require_all("filter", k.filter > 0 && k.filter <= 1, "above 0, at most 1");
    not_negative("disturbance", k.disturbance);
    not_negative("innovation_power", k.power);
    not_negative("innovation_power_at_change", k.at_change);
    const ts_oscillation &o = c.oscillation;
    not_negative("mean_speed", o.speed);
    not_negative("mean_acceleration", o.acceleration);
    not_negative("oscillation_time", o.time);
    not_negative("half_wave_peak", o.peak);
    require_range("half_wave_sign", o.sign, -1, 1);
    require_range("half_wave_length", o.length, 0, INT32_MAX);
    require_range("half_wave_missed", o.missed, 0, 1 << 20);
    require_range("half_waves_regular", o.regular, 0, TS_HALF_WAVES);
    for (int i = 0; i < TS_HALF_WAVES; i++) require_range("half_wave_lengths", o.lengths[i], i < o.regular, INT32_MAX);
    const ts_stage &g = c.stage;
    require_all("resonance", g.resonance >= 0 && g.resonance <= 1, "from 0 to 1");
    not_negative("inertia", g.inertia);
    require_all("smoothing", g.smoothing >= 0 && g.smoothing < 1, "0 or more, below 1");
    not_negative("rest", g.rest);
    not_negative("weights_age", g.age);
    const ts_growth &e = g.before.growth;
    bool counted = e.ticks >= 0 && e.windows >= 0 && e.speed >= 0 && e.square >= 0 && e.least >= 0 && e.held >= 0 && e.good >= 0 && e.left >= 0 && e.wait >= 1 && e.pace >= 0 && e.paced >= 0 && e.before >= 0 && e.rising >= 0;
    require_all("growth", !c.found.known || counted, "of counts and errors of 0 or more, and a wait of 1 or more");
    require_all("pending", !k.pending || k.variance > 0, "0 where innovation_variance is 0");
    check_covariance(c, "covariance", k.P);
    check_resonance(c);
    check_guard(c);
}

void check_rls(const ts_controller &c) {
    const ts_rls &r = c.law.rls;
    require_all("covariance_trace", r.trace >= 0, "0 or more");
    for (int j = 0; j < c.parameters; j++) {
        require_all("covariance_diagonal", r.D[j] >= 0, "of numbers of 0 or more");
        require_all("covariance_factor", r.U[TS_ROW(j) + j] == 1, "1 on its diagonal");
        for (int i = j + 1; i < static_cast<int>(TS_PADDED(j + 1)); i++)
            require_all("covariance_factor", r.U[TS_ROW(j) + i] == 0, "0 below its diagonal");
    }
}

void check_state(const ts_controller &c) {
    const ts_settings &s = *c.settings;
    check_counters(c);
    check_plays(s, "play", c.now.play);
    check_plays(s, "lagged_play", c.lagged.play);
    ts_real least = s.law == TS_LAW_KALMAN ? TS_IN_MOTION * s.slope_min : s.slope_min;
    for (int i = 0; i < s.plays; i++)
        require_all("slopes", c.slopes[i] >= least && c.slopes[i] <= s.slope_max, "within slope_limits");
    require_all("fastest", c.fastest >= 0, "0 or more");
    require_all("resolution", c.resolution >= 0, "0 or more");
    if (s.law == TS_LAW_KALMAN) check_kalman(c);
    else check_rls(c);
}

void require(ts_status status) {
    if (status == TS_NOT_FINITE) throw std::invalid_argument("volts and z must be finite");
    if (status == TS_BEYOND_REACH) throw std::invalid_argument("z is beyond the reach of the stroke under these volts");
    if (status != TS_OK) throw std::invalid_argument(std::string("the kernel refuses ") + ts_status_setting(status));
}

class Kernel {
  public:
    explicit Kernel(const nb::dict &settings) {
        settings_ = std::make_unique<const ts_settings>(settings_from(settings));
        require(ts_controller_init(&c_, settings_.get()));
    }

    void start(double volts, double z) {
        require(ts_controller_start(&c_, static_cast<ts_real>(volts), static_cast<ts_real>(z)));
    }

    void change(const nb::dict &settings) {
        auto next = std::make_unique<const ts_settings>(settings_from(settings));
        require(ts_controller_change(&c_, next.get()));
        settings_ = std::move(next);
    }

    // NaN: not known, of zddot_d and strain_d. All are finite but for that. others: three for each other axis, or null.
    double command(double z_d, double zdot_d, double zddot_d, double strain_d, const ts_real *others) {
        ts_real volts;
        if (ts_controller_follow(&c_, static_cast<ts_real>(z_d), static_cast<ts_real>(zdot_d), static_cast<ts_real>(zddot_d),
                                 static_cast<ts_real>(strain_d), others, &volts) != TS_OK)
            throw std::invalid_argument("a desired value is too large for the kernel's number type");
        return volts;
    }

    ts_status adapt(double z_measured, int ago) {
        return ts_controller_adapt(&c_, static_cast<ts_real>(z_measured), ago);
    }

    // The voltage (V) that the command `ago` commands before the last one gave.
    double volts_of(int ago) const {
        return c_.x[(c_.counters.commands - 1 - static_cast<uint64_t>(ago)) % TS_HISTORY];
    }

    // SettingError where the first measurement of a loop that cannot raise was beyond reach.
    void require_reach() {
        if (!beyond_) return;
        auto [z, volts] = *beyond_;
        beyond_.reset();
        raise_beyond_reach(z, volts);
    }

    [[noreturn]] void raise_beyond_reach(double z, double volts) const {
        nb::object error = beyond_reach(z, volts);
        PyErr_SetObject(reinterpret_cast<PyObject *>(Py_TYPE(error.ptr())), error.ptr());
        throw nb::python_error();
    }

    nb::object beyond_reach(double z, double volts) const {
        return nb::module_::import_("truestroke.base.checks").attr("beyond_reach")(
            "z_measured", z, volts, static_cast<double>(ts_reach(c_.settings, static_cast<ts_real>(volts))),
            static_cast<double>(c_.settings->stroke));
    }

    void process(Vector<double> z_d, Vector<double> zdot_d, std::optional<Vector<double>> z_measured, Output volts,
                 int ago) {
        size_t n = volts.shape(0);
        if (z_d.shape(0) != n || zdot_d.shape(0) != n || (z_measured && z_measured->shape(0) != n))
            throw std::invalid_argument("z_d, zdot_d, z_measured and volts must have the same length");
        for (size_t k = 0; k < n; k++) { // all of them before any state changes
            require_finite("z_d", static_cast<ts_real>(z_d.data()[k]), "um");
            require_finite("zdot_d", static_cast<ts_real>(zdot_d.data()[k]), "um/s");
        }
        std::unique_ptr<const ts_controller> before; // for a first measurement that is refused
        if (z_measured && c_.lagged.ticks == 0) before = std::make_unique<const ts_controller>(c_);
        size_t k = 0;
        bool good = true;
        {
            nb::gil_scoped_release release;
            for (; k < n && good; k++) {
                ts_real x = 0;
                ts_controller_command(&c_, static_cast<ts_real>(z_d.data()[k]), static_cast<ts_real>(zdot_d.data()[k]),
                                      &x);
                volts.data()[k] = x;
                if (z_measured) good = adapt(z_measured->data()[k], ago) != TS_BEYOND_REACH;
            }
        }
        if (good) return;
        double refused = volts_of(ago);
        c_ = *before;
        raise_beyond_reach(z_measured->data()[k - 1], refused);
    }

    // Nothing may be thrown through the loop, which is C: require_reach tells afterwards.
    void adapt_in_loop(double z) {
        if (adapt(z, 0) == TS_BEYOND_REACH && !beyond_) beyond_ = {z, volts_of(0)};
    }

    // This controller as the native loop calls it.
    static nb::capsule native(nb::object self) {
        ts_loop_controller calls{
            nb::inst_ptr<Kernel>(self),
            [](void *k, const double motion[4], const double *others) {
                ts_real x = NAN; // stays where a desired value is too large for the number type
                auto &c = static_cast<Kernel *>(k)->c_;
                ts_real moving[3 * TS_MAX_OTHERS] = {};
                for (int i = 0; others && i < 3 * c.settings->terms[TS_COUPLING]; i++) moving[i] = static_cast<ts_real>(others[i]);
                ts_controller_follow(&c, static_cast<ts_real>(motion[0]), static_cast<ts_real>(motion[1]),
                                     static_cast<ts_real>(motion[2]), static_cast<ts_real>(motion[3]),
                                     others ? moving : nullptr, &x);
                return static_cast<double>(x);
            },
            [](void *k, double z) { static_cast<Kernel *>(k)->adapt_in_loop(z); },
            [](void *k) { return static_cast<unsigned>(static_cast<Kernel *>(k)->flags()); },
            [](void *k) { return static_cast<Kernel *>(k)->innovation(); },
        };
        return in_capsule("ts_loop_controller", calls, self);
    }

    void reset() { ts_controller_reset(&c_); }
    void hold(bool on) { ts_controller_hold(&c_, on); }

    int others() const { return c_.settings->terms[TS_COUPLING]; }
    size_t plays() const { return static_cast<size_t>(c_.settings->plays); }
    size_t parameters() const { return static_cast<size_t>(c_.parameters); }

    // Everything that a tick leaves behind, by name; restore() takes the same dictionary.
    nb::dict state() {
        nb::dict d;
        ts_controller_complete(&c_);
        each_array(c_, [&d](const char *name, const auto *data, size_t count) { d[name] = copy_of(data, {count}); });
        return d;
    }

    void restore(const nb::dict &d) {
        ts_controller_complete(&c_); // what waits is of the state before
        auto next = std::make_unique<ts_controller>(c_); // so that a bad entry changes nothing
        each_array(*next, [&d](const char *name, auto *data, size_t count) { take(d, name, data, count); });
        check_state(*next);
        c_ = *next;
    }

    nb::object weights() const { return copy_of(c_.w, {parameters()}); }
    nb::object slopes() const { return copy_of(c_.slopes, {plays()}); }
    nb::object play() const { return copy_of(c_.now.play, {plays()}); }
    double innovation() const { return c_.innovation; }
    double trace() {
        if (c_.settings->law == TS_LAW_RLS) return c_.law.rls.trace;
        ts_controller_complete(&c_);
        double sum = 0;
        for (int i = 0; i < c_.parameters; i++) sum += c_.law.kalman.P[TS_ROW(i) + i];
        return sum;
    }
    nb::object covariance() { // m x m, as P of the paper
        int m = c_.parameters;
        ts_controller_complete(&c_);
        std::vector<double> P(parameters() * parameters());
        for (int i = 0; i < m; i++)
            for (int j = 0; j <= i; j++) {
                double sum = 0;
                if (c_.settings->law == TS_LAW_RLS)
                    for (int k = i; k < m; k++) {
                        const ts_real *column = c_.law.rls.U + TS_ROW(k);
                        sum += static_cast<double>(c_.law.rls.D[k]) * column[i] * column[j];
                    }
                else
                    sum = c_.law.kalman.P[TS_ROW(i) + j];
                P[static_cast<size_t>(i * m + j)] = P[static_cast<size_t>(j * m + i)] = sum;
            }
        return copy_of(P.data(), {parameters(), parameters()});
    }
    // Of the first resonance that was told or found, and of the corner of the law's filter, cycles per tick; NaN for
    // the first where none is known, for both where the law is not the Kalman filter.
    double resonance() const { return c_.stage.resonance > 0 ? c_.stage.resonance : NAN; }
    nb::tuple load() const { // of the loudest, cycles per tick, um; NaN where none was heard, or none exceeds the noise
        double turns = NAN, loudest = NAN;
        for (int i = 0; i < TS_HEARD && c_.hum.heard[i].line[2] > 0; i++) {
            const ts_real *a = c_.hum.sine[c_.settings->hum.lines + i];
            double size = std::hypot(a[0], a[1]);
            if (c_.hum.heard[i].beyond > 0 || size <= loudest || !(size > c_.law.kalman.sigma)) continue;
            loudest = size;
            turns = turns_of(c_.hum.heard[i]);
        }
        return nb::make_tuple(turns, loudest);
    }
    nb::tuple beyond() const { // the resonance, the loudest when it was heard, as `load`: law and feedback may have driven it
        double turns = NAN, loudest = NAN;
        for (int i = 0; i < TS_HEARD && c_.hum.heard[i].line[2] > 0; i++) {
            const ts_load &line = c_.hum.heard[i];
            if (!(line.beyond > 0) || line.announced <= loudest || !(line.announced > c_.law.kalman.sigma)) continue;
            loudest = line.announced;
            turns = turns_of(line);
        }
        return nb::make_tuple(turns, loudest);
    }
    double turns_of(const ts_load &line) const { return line.line[2] * c_.settings->oscillation.tick / (2 * TS_PI); }
    double filter() const { return c_.settings->law == TS_LAW_KALMAN ? c_.law.kalman.filter : NAN; }
    double noise() const { return c_.settings->law == TS_LAW_KALMAN ? c_.law.kalman.sigma : NAN; }
    int flags() const {
        return c_.flags.saturated | c_.flags.projected << 1 | c_.flags.rejected << 2 | c_.flags.held << 3 |
               c_.flags.changed << 4 | c_.flags.slewed << 5 | c_.flags.oscillating << 6 | c_.flags.restored << 7;
    }
    nb::tuple counters() const {
        const ts_counters &n = c_.counters;
        return nb::make_tuple(n.commands, n.adaptations, n.saturated, n.projected, n.rejected, n.changed, n.slewed,
                              n.oscillating, n.restored);
    }

  private:
    template <typename T> static void take(const nb::dict &d, const char *name, T *target, size_t size) {
        if (!d.contains(name)) throw std::invalid_argument(std::string("state has no entry ") + name);
        nb::ndarray<const T, nb::c_contig, nb::device::cpu> source;
        if (!nb::try_cast(d[name], source) || source.size() != size)
            throw std::invalid_argument(std::string("state entry ") + name + " must have " + std::to_string(size) +
                                        " entries of the kernel's number type");
        constexpr T largest = std::is_floating_point_v<T> ? static_cast<T>(TS_LARGEST * TS_LARGEST) : T{};
        for (size_t i = 0; i < size; i++)
            if constexpr (std::is_floating_point_v<T>)
                require_all(name, std::abs(source.data()[i]) <= largest, "finite, and no larger than the kernel can hold");
            else if constexpr (std::is_same_v<T, bool>) { // a byte that is neither has no meaning as a bool
                unsigned char value;
                std::memcpy(&value, source.data() + i, 1);
                require_all(name, value <= 1, "of flags, each 0 or 1");
            }
        std::copy(source.data(), source.data() + size, target);
    }

    std::unique_ptr<const ts_settings> settings_; // to which c_ points
    ts_controller c_{};
    std::optional<std::pair<double, double>> beyond_; // z, um, and volts, V: refused in a native loop
};

// ---- The two calls of a tick -----------------------------------------------------------------------------------------
// Functions of CPython's own kind: nanobind's search for the overload would take as long as the kernel.

// The values of `count` parameters, by position or by name; false, with the error set, where they do not fit.
bool take_arguments(const char *const *names, Py_ssize_t count, PyObject **values, PyObject *const *args,
                    Py_ssize_t positional, PyObject *keywords) {
    Py_ssize_t given = keywords ? PyTuple_Size(keywords) : 0;
    bool fits = positional + given <= count;
    for (Py_ssize_t i = 0; fits && i < positional; i++) values[i] = args[i];
    for (Py_ssize_t k = 0; fits && k < given; k++) {
        PyObject *name = PyTuple_GetItem(keywords, k);
        Py_ssize_t i = positional;
        while (i < count && PyUnicode_CompareWithASCIIString(name, names[i]) != 0) i++;
        fits = i < count;
        if (fits) values[i] = args[positional + k];
    }
    for (Py_ssize_t i = 0; fits && i < count; i++) fits = values[i] != nullptr;
    if (!fits) PyErr_Format(PyExc_TypeError, "the arguments are %s, %s", names[0], names[1]);
    return fits;
}

Kernel *kernel_of(PyObject *self) {
    if (nb::inst_ready(self)) return nb::inst_ptr<Kernel>(self);
    PyErr_SetString(PyExc_TypeError, "Kernel.__init__ was not called");
    return nullptr;
}

// What a call says of an argument that is no finite number: SettingError in the words of `checks`, in place of the error
// that is set; that one where the number is one.
PyObject *refused(const char *name, PyObject *value, const char *unit) {
    PyObject *type, *before, *trace;
    PyErr_Fetch(&type, &before, &trace);
    try {
        nb::module_::import_("truestroke.base.checks").attr("number")(name, nb::handle(value), unit);
        PyErr_Restore(type, before, trace);
    } catch (nb::python_error &error) {
        Py_XDECREF(type), Py_XDECREF(before), Py_XDECREF(trace);
        error.restore();
    }
    return nullptr;
}

// The motion of the other axes, three numbers for each; false, with the error set, where it does not fit.
bool take_others(const Kernel &kernel, PyObject *value, ts_real *moving) {
    int count = 3 * kernel.others();
    PyObject *entries = PySequence_Tuple(value);
    bool fits = entries && PyTuple_Size(entries) == count;
    for (int i = 0; fits && i < count; i++) {
        double number = PyFloat_AsDouble(PyTuple_GetItem(entries, i));
        fits = std::isfinite(number) && !(number == -1 && PyErr_Occurred());
        moving[i] = static_cast<ts_real>(number);
    }
    Py_XDECREF(entries);
    if (fits) return true;
    PyErr_Clear();
    try {
        nb::object error = nb::module_::import_("truestroke.base.checks").attr("wrong_others")(nb::handle(value), kernel.others());
        PyErr_SetObject(reinterpret_cast<PyObject *>(Py_TYPE(error.ptr())), error.ptr());
    } catch (nb::python_error &error) {
        error.restore();
    }
    return false;
}

PyObject *command(PyObject *self, PyObject *const *args, Py_ssize_t positional, PyObject *keywords) {
    static const char *const names[] = {"z_d", "zdot_d", "zddot_d", "strain_d", "others"};
    static const char *const units[] = {"um", "um/s", "um/s^2", "um"};
    PyObject *values[5] = {nullptr, nullptr, Py_None, Py_None, Py_None}; // None: not known
    if (!take_arguments(names, 5, values, args, positional, keywords)) return nullptr;
    Kernel *kernel = kernel_of(self);
    if (!kernel) return nullptr;
    double numbers[4];
    for (int i = 0; i < 4; i++) {
        numbers[i] = values[i] == Py_None && i > 1 ? NAN : PyFloat_AsDouble(values[i]);
        if (numbers[i] == -1 && PyErr_Occurred()) return refused(names[i], values[i], units[i]);
        if (!std::isfinite(numbers[i]) && (values[i] != Py_None || i < 2)) {
            PyErr_SetString(PyExc_ValueError, "not finite");
            return refused(names[i], values[i], units[i]);
        }
    }
    ts_real moving[3 * TS_MAX_OTHERS];
    bool among = values[4] != Py_None;
    if (among && !take_others(*kernel, values[4], moving)) return nullptr;
    try {
        return PyFloat_FromDouble(kernel->command(numbers[0], numbers[1], numbers[2], numbers[3], among ? moving : nullptr));
    } catch (const std::exception &e) {
        PyErr_SetString(PyExc_ValueError, e.what());
        return nullptr;
    }
}

PyObject *adapt(PyObject *self, PyObject *const *args, Py_ssize_t positional, PyObject *keywords) {
    static const char *const names[] = {"z_measured", "ago"};
    PyObject *values[2] = {nullptr, Py_None}; // None: 0
    if (!take_arguments(names, 2, values, args, positional, keywords)) return nullptr;
    Kernel *kernel = kernel_of(self);
    if (!kernel) return nullptr;
    double z = PyFloat_AsDouble(values[0]);
    if (z == -1 && PyErr_Occurred()) return refused("z_measured", values[0], "um");
    long ago = values[1] == Py_None ? 0 : PyLong_AsLong(values[1]);
    if (ago == -1 && PyErr_Occurred()) {
        PyErr_Clear();
        try {
            nb::object count = nb::module_::import_("truestroke.base.checks").attr("count");
            ago = nb::cast<long>(count("ago", nb::handle(values[1]), 0, TS_HISTORY - 1));
        } catch (nb::python_error &error) {
            error.restore();
            return nullptr;
        }
    }
    int late = static_cast<int>(std::clamp(ago, -1L, static_cast<long>(TS_HISTORY))); // both ends are refused
    if (kernel->adapt(z, late) == TS_BEYOND_REACH) {
        try {
            kernel->raise_beyond_reach(z, kernel->volts_of(late));
        } catch (nb::python_error &error) {
            error.restore();
        }
        return nullptr;
    }
    Py_INCREF(Py_None);
    return Py_None;
}

PyMethodDef tick_calls[] = {
    {"command", reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(&command)), METH_FASTCALL | METH_KEYWORDS,
     "command($self, z_d, zdot_d, zddot_d=None, strain_d=None, others=None)\n--\n\nVoltage, V, for z_d, um, zdot_d, um/s, and zddot_d, um/s^2."},
    {"adapt", reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(&adapt)), METH_FASTCALL | METH_KEYWORDS,
     "adapt($self, z_measured, ago=0)\n--\n\nLearn from the displacement z_measured, um."},
};

// ---- Repetition ------------------------------------------------------------------------------------------------------

std::vector<ts_real> period_of(const nb::dict &d, const char *name, size_t size) {
    auto source = nb::cast<Vector<double>>(d[name]);
    if (source.shape(0) != size) throw std::invalid_argument(std::string(name) + " must have one entry for each phase");
    return std::vector<ts_real>(source.data(), source.data() + size);
}

template <typename T> T member(const nb::dict &d, const char *name) { return static_cast<T>(nb::cast<double>(d[name])); }

// ts_repetition with its memory and its tables.
class Repetition {
  public:
    explicit Repetition(const nb::dict &given) : given_(given) {
        settings_.size = nb::cast<int>(given["size"]);
        settings_.period = member<ts_real>(given, "period");
        settings_.change = member<ts_real>(given, "change");
        settings_.share = member<ts_real>(given, "share");
        settings_.cosine = member<ts_real>(given, "cosine");
        settings_.sine = member<ts_real>(given, "sine");
        settings_.ratio = member<ts_real>(given, "ratio");
        settings_.settles = nb::cast<int>(given["settles"]);
        size_t size = settings_.size > 0 ? static_cast<size_t>(settings_.size) : 0;
        if (!given["learned"].is_none()) take_learned(nb::cast<nb::dict>(given["learned"]), size);
        memory_.resize(2 * size);
        for (auto &table : tables_) table.resize(size);
        if (!ts_repetition_init(&r_, &settings_, memory_.data()))
            throw std::invalid_argument("the kernel refuses the settings of a repetition");
    }
    Repetition(const Repetition &) = delete;
    Repetition &operator=(const Repetition &) = delete;

    bool tick(double z_d) { return ts_repetition_tick(&r_, static_cast<ts_real>(z_d)); }
    void trigger() { ts_repetition_trigger(&r_); }
    void leave() { ts_repetition_leave(&r_); }
    bool become(std::optional<Vector<double>> volts, double scale, int waits) {
        if (!volts) return ts_repetition_become(&r_, nullptr, 0, waits);
        int to = ts_repetition_free(&r_);
        if (volts->shape(0) != size()) throw std::invalid_argument("a correction has one entry for each phase");
        if (to < 0) return false;
        auto &table = tables_[to];
        std::copy(volts->data(), volts->data() + size(), table.begin());
        return ts_repetition_become(&r_, table.data(), static_cast<ts_real>(scale), waits);
    }
    void move(double volts, double ticks) {
        ts_repetition_move(&r_, static_cast<ts_real>(volts), static_cast<ts_real>(ticks));
    }
    double volts(double inside, double low, double high, double slew) {
        return ts_repetition_volts(&r_, static_cast<ts_real>(inside), static_cast<ts_real>(low),
                                   static_cast<ts_real>(high), static_cast<ts_real>(slew));
    }
    bool see(double error, double gain) {
        return ts_repetition_see(&r_, static_cast<ts_real>(error), static_cast<ts_real>(gain));
    }

    size_t size() const { return static_cast<size_t>(settings_.size); }
    double at() const {
        return static_cast<double>(r_.turns) * settings_.size + r_.place + static_cast<double>(r_.part);
    }
    double period() const { return static_cast<double>(settings_.size) / static_cast<double>(r_.pace); }
    double goal() const { return r_.goal; }
    bool repeats() const { return r_.repeats; }
    bool joined() const { return r_.joined; }
    bool corrects() const { return r_.corrects; }
    bool slewed() const { return r_.slewed; }
    bool saturated() const { return r_.saturated; }
    uint64_t limited() const { return r_.limited; }
    nb::object wave() const {
        if (!r_.shape.wave) throw std::invalid_argument("no period of the motion is known");
        return copy_of(r_.shape.wave, {size()});
    }

    nb::dict state() {
        std::vector<ts_real> numbers;
        std::vector<int64_t> counts;
        std::vector<uint8_t> flags;
        ts_shape shape = r_.shape.wave ? r_.shape : ts_shape{};
        each_number(r_, shape, [&numbers](ts_real &x) { numbers.push_back(x); });
        each_count(r_, [&counts](auto &x) { counts.push_back(static_cast<int64_t>(x)); });
        bool known = r_.shape.wave != nullptr;
        each_flag(r_, known, [&flags](bool &x) { flags.push_back(x); });
        nb::dict d;
        d["numbers"] = copy_of(numbers.data(), {numbers.size()});
        d["counts"] = copy_of(counts.data(), {counts.size()});
        d["flags"] = copy_of(flags.data(), {flags.size()}).attr("astype")("bool");
        d["now"] = copy_of(r_.now, {size()});
        d["other"] = copy_of(r_.other, {size()});
        for (int i = 0; i < 2; i++) {
            std::vector<ts_real> none(size());
            d[i ? "added_1" : "added_0"] = copy_of(r_.added[i].volts ? r_.added[i].volts : none.data(), {size()});
        }
        return d;
    }

    void restore(const nb::dict &d) {
        ts_repetition next = r_;
        ts_shape shape{};
        bool known = false, good = true;
        std::vector<ts_real> memory(2 * size()), tables[2];
        auto numbers = entries<ts_real>(d, "numbers");
        auto counts = entries<int64_t>(d, "counts");
        auto flags = entries<uint8_t>(d, "flags");
        size_t i = 0;
        auto fill = [&i, &good](auto &source, auto &x) { // a size that is wrong is seen at the end
            if (i < source.size()) x = static_cast<std::remove_reference_t<decltype(x)>>(source[i]);
            i++;
        };
        each_number(next, shape, [&](ts_real &x) { fill(numbers, x); });
        good = i == numbers.size();
        for (ts_real x : numbers) good = good && std::abs(x) <= static_cast<ts_real>(TS_LARGEST * TS_LARGEST);
        i = 0;
        each_count(next, [&](auto &x) { fill(counts, x); });
        good = good && i == counts.size();
        for (int64_t x : counts) good = good && x >= 0 && x < int64_t{1} << 62;
        i = 0;
        each_flag(next, known, [&](bool &x) { fill(flags, x); });
        good = good && i == flags.size() && next.place < settings_.size && next.part >= 0 && next.part < 1 &&
               next.counted < settings_.size && next.step > 0 && next.pace > 0 && next.step < 2 && next.changed >= 0 &&
               next.changed <= 1 && (known || !next.repeats) && (next.repeats || !next.aligned) &&
               (next.aligned || !next.joined) && (settings_.learned || !next.aligned) && shape.span >= 0 &&
               shape.slopes >= 0 && next.amplitude > 0;
        const char *names[] = {"now", "other", "added_0", "added_1"};
        for (int k = 0; k < 4; k++) {
            auto table = entries<ts_real>(d, names[k]);
            good = good && table.size() == size();
            for (ts_real x : table) good = good && std::abs(x) <= TS_LARGEST;
            if (k < 2 && good) std::copy(table.begin(), table.end(), memory.begin() + static_cast<ptrdiff_t>(k * size()));
            if (k >= 2) tables[k - 2] = std::move(table);
        }
        if (!good) throw std::invalid_argument("it is no state of a repetition");
        memory_ = std::move(memory);
        next.now = memory_.data();
        next.other = memory_.data() + size();
        next.shape = shape;
        next.shape.wave = !known ? nullptr : next.aligned ? settings_.learned->shape.wave : next.other;
        for (int k = 0; k < 2; k++) {
            tables_[k] = std::move(tables[k]);
            next.added[k].volts = tables_[k] == volts_ ? volts_.data() : tables_[k].data();
        }
        r_ = next;
    }

    nb::tuple getstate() { return nb::make_tuple(given_, state()); }
    static void setstate(Repetition &self, const nb::tuple &state) {
        new (&self) Repetition(nb::cast<nb::dict>(state[0]));
        self.restore(nb::cast<nb::dict>(state[1]));
    }

  private:
    template <typename Visit> static void each_number(ts_repetition &r, ts_shape &shape, Visit visit) {
        for (ts_real *x : {&r.pace, &r.step, &r.part, &r.value, &r.amplitude, &r.offset, &r.drift, &r.error, &r.own,
                           &r.slope, &r.square, &r.first, &r.sum, &r.squares, &r.low, &r.high, &r.slopes, &r.turned[0],
                           &r.turned[1], &r.fundamental[0], &r.fundamental[1], &r.changed, &r.level, &r.goal, &r.climb,
                           &r.errors, &r.kept, &r.range, &r.last, &shape.mean, &shape.span, &shape.power, &shape.slopes,
                           &shape.cosine, &shape.sine, &r.added[0].from, &r.added[1].from, &r.added[0].to,
                           &r.added[1].to})
            visit(*x);
    }
    template <typename Visit> static void each_count(ts_repetition &r, Visit visit) {
        visit(r.place), visit(r.turns), visit(r.alike), visit(r.counted), visit(r.waits), visit(r.limited);
    }
    template <typename Visit> static void each_flag(ts_repetition &r, bool &known, Visit visit) {
        for (bool *x : {&r.started, &r.whole, &r.begun, &r.triggered, &r.repeats, &r.aligned, &r.joined, &r.corrects,
                        &r.slewed, &r.saturated, &r.commanded, &known})
            visit(*x);
    }
    template <typename T> static std::vector<T> entries(const nb::dict &d, const char *name) {
        if (!d.contains(name)) throw std::invalid_argument(std::string("state has no entry ") + name);
        nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu> source;
        nb::object value = d[name];
        if constexpr (std::is_same_v<T, uint8_t>) value = value.attr("astype")("uint8");
        if (!nb::try_cast(value, source)) throw std::invalid_argument(std::string("state entry ") + name + ": wrong numbers");
        return std::vector<T>(source.data(), source.data() + source.shape(0));
    }
    void take_learned(const nb::dict &l, size_t size) {
        wave_ = period_of(l, "wave", size);
        volts_ = period_of(l, "volts", size);
        learned_ = {{wave_.data(), member<ts_real>(l, "mean"), member<ts_real>(l, "span"), member<ts_real>(l, "power"),
                     member<ts_real>(l, "slopes"), member<ts_real>(l, "cosine"), member<ts_real>(l, "sine")},
                    volts_.data(), member<ts_real>(l, "level"), member<ts_real>(l, "gain")};
        settings_.learned = &learned_;
    }

    nb::dict given_;
    std::vector<ts_real> memory_, tables_[2], wave_, volts_;
    ts_learned_period learned_{};
    ts_repetition_settings settings_{};
    ts_repetition r_{};
};

// ---- Whole arrays ----------------------------------------------------------------------------------------------------

std::vector<ts_real> reals(const Vector<double> &source) {
    return std::vector<ts_real>(source.data(), source.data() + source.shape(0));
}

void require_lengths(bool equal) {
    if (!equal) throw std::invalid_argument("arrays of one axis must have the same length");
}

using Rows = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Columns = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Places = nb::ndarray<int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// Plays (1) along x; every `every`-th row is kept, from the first. y holds the states before, then behind.
void play_history(Vector<double> x, Vector<double> r, Output y, size_t every, Rows rows) {
    size_t n = r.shape(0), ticks = x.shape(0);
    require_lengths(y.shape(0) == n && rows.shape(1) == n && every > 0 && rows.shape(0) == (ticks + every - 1) / every);
    std::vector<ts_real> thresholds = reals(r), state(y.data(), y.data() + n);
    nb::gil_scoped_release release;
    for (size_t k = 0; k < ticks; k++) {
        ts_play_bank(static_cast<ts_real>(x.data()[k]), thresholds.data(), state.data(), static_cast<int>(n));
        if (k % every == 0) std::copy(state.begin(), state.end(), rows.data() + k / every * n);
    }
    std::copy(state.begin(), state.end(), y.data());
}

#if defined(_MSC_VER)
#define TS_APART __restrict
#else
#define TS_APART __restrict__
#endif

// Rows of a tick, a column beside the next: the arrays do not overlap, so that several columns are computed at once.
void add_row(size_t n, double tap, const double *TS_APART u, double *TS_APART now) {
    for (size_t j = 0; j < n; j++) now[j] += tap * u[j];
}

void section_row(size_t n, const double *c, const double *TS_APART u, double *TS_APART first, double *TS_APART second,
                 double *TS_APART now) {
    const double b0 = c[0], b1 = c[1], a1 = c[2], a2 = c[3];
    for (size_t j = 0; j < n; j++) {
        double y = b0 * u[j] + first[j];
        first[j] = b1 * u[j] - a1 * y + second[j];
        second[j] = -a2 * y;
        now[j] += y;
    }
}

void lag_row(size_t n, const double *lag, double part, const double *TS_APART in, const double *TS_APART now,
             const double *TS_APART moved, double *TS_APART lagged, double *TS_APART out) {
    const double b0 = lag[0], b1 = lag[1], p = lag[2];
    for (size_t j = 0; j < n; j++) {
        double z = b0 * now[j] + b1 * moved[j] + p * lagged[j];
        out[j] = in[j] + (1 - part) * z + part * lagged[j];
        lagged[j] = z;
    }
}

// Columns behind a stage (taps and parallel sections b0, b1, a1, a2), a lag (b0, b1, p) and a dead time of `dead` samples
// and a part of one, at rest before the first row: of every `every`-th sample.
void respond_rows(Columns columns, Vector<double> taps, Columns sections, Vector<double> lag, size_t dead, double part,
                  size_t every, Rows rows) {
    size_t ticks = columns.shape(0), n = columns.shape(1), own = sections.shape(0), t = taps.shape(0);
    require_lengths(rows.shape(1) == n && every > 0 && rows.shape(0) == (ticks + every - 1) / every && t > 0 &&
                    lag.shape(0) == 3 && (own == 0 || sections.shape(1) == 4));
    if (ticks == 0) return;
    const double *in = columns.data();
    std::vector<double> past((t + 2 * own + 3) * n), none(n);
    double *u = past.data(), *state = u + t * n, *moved = state + 2 * own * n, *now = moved + n, *lagged = now + n;
    nb::gil_scoped_release release;
    for (size_t k = 0; k < ticks; k++) {
        const double *at = in + (k < dead ? 0 : k - dead) * n;
        for (size_t i = t - 1; i > 0; i--) std::copy(u + (i - 1) * n, u + i * n, u + i * n);
        for (size_t j = 0; j < n; j++) u[j] = at[j] - in[j];
        for (size_t j = 0; j < n; j++) now[j] = taps.data()[0] * u[j];
        for (size_t i = 1; i < t; i++) add_row(n, taps.data()[i], u + i * n, now);
        for (size_t i = 0; i < own; i++)
            section_row(n, sections.data() + 4 * i, u, state + 2 * i * n, state + (2 * i + 1) * n, now);
        lag_row(n, lag.data(), part, in, now, moved, lagged, k % every == 0 ? rows.data() + k / every * n : none.data());
        std::swap(now, moved);
    }
}

// Displacement of the sums of the plays and of known terms (a row of `known` each) with their weights: z minus its
// asymmetry is this sum, um.
void displacement(Vector<double> plays, Columns known, Vector<double> weights, Vector<double> asymmetry, double stroke,
                  Output z) {
    size_t ticks = plays.shape(0), n = weights.shape(0), terms = asymmetry.shape(0);
    require_lengths(z.shape(0) == ticks && known.shape(0) == n && known.shape(1) == ticks && terms <= TS_MAX_ASYMMETRY);
    constexpr size_t block = 64; // ticks whose terms are beside each other: a row of `known` is read in one go
    std::vector<ts_real> w = reals(weights), curved = reals(asymmetry), at(block * n);
    nb::gil_scoped_release release;
    for (size_t first = 0; first < ticks; first += block) {
        const size_t end = std::min(first + block, ticks);
        for (size_t i = 0; i < n; i++)
            for (size_t k = first; k < end; k++)
                at[(k - first) * n + i] = static_cast<ts_real>(known.data()[i * ticks + k]);
        for (size_t k = first; k < end; k++) {
            const ts_real y = static_cast<ts_real>(plays.data()[k]) +
                              ts_dot(w.data(), at.data() + (k - first) * n, static_cast<int>(n));
            z.data()[k] = ts_with_asymmetry(curved.data(), static_cast<int>(terms), static_cast<ts_real>(stroke), y);
        }
    }
}

// States of Duhem along s, one state of s and one of s^2 for each beta (in units of s), from rest at the first of s: of
// every `every`-th row behind it. Straight lines between samples, c = P(s) + (c0 - P(s0)) exp(-beta |ds|).
void duhem_states(Vector<double> s, Vector<double> betas, double half, size_t every, Rows rows) {
    const size_t ticks = s.shape(0) - 1, n = betas.shape(0);
    require_lengths(s.shape(0) > 0 && every > 0 && rows.shape(0) == (ticks + every - 1) / every &&
                    rows.shape(1) == 2 * n);
    std::vector<double> c(2 * n);
    for (size_t j = 0; j < n; j++) {
        c[2 * j] = half * s.data()[0];
        c[2 * j + 1] = half * (0.5 * s.data()[0] * s.data()[0]);
    }
    nb::gil_scoped_release release;
    for (size_t k = 0; k < ticks; k++) {
        const double from = s.data()[k], to = s.data()[k + 1], way = std::fabs(to - from), sign = to < from ? -1.0 : 1.0;
        for (size_t j = 0; j < n && way > 0.0; j++) {
            const double lag = sign / betas.data()[j], kept = std::exp(-betas.data()[j] * way);
            const double begun = from - lag, ends = to - lag;
            c[2 * j] = half * ends + kept * (c[2 * j] - half * begun);
            c[2 * j + 1] = half * (0.5 * to * to - ends * lag) +
                           kept * (c[2 * j + 1] - half * (0.5 * from * from - begun * lag));
        }
        if (k % every == 0) std::copy(c.begin(), c.end(), rows.data() + k / every * 2 * n);
    }
}

// Creep states along x, a row for each share of the distance to x of the tick before: at rest at the first x.
void creep_rows(Vector<double> x, Vector<double> shares, Rows rows) {
    const size_t ticks = x.shape(0), n = shares.shape(0);
    require_lengths(rows.shape(0) == n && rows.shape(1) == ticks);
    std::vector<double> carried(n, 0.0);
    nb::gil_scoped_release release;
    for (size_t k = 0; k < ticks; k++) {
        const double first = x.data()[0], u = x.data()[k > 0 ? k - 1 : 0] - first;
        for (size_t j = 0; j < n; j++) {
            const double c = shares.data()[j], y = carried[j] + c * u;
            carried[j] = -y * (c - 1.0);
            rows.data()[j * ticks + k] = first + y;
        }
    }
}

// Points (a column each), each the one farthest from those before it; the first two are the first and the last column.
void farthest(Columns points, Places chosen) {
    const size_t n = points.shape(1), count = chosen.shape(0);
    require_lengths(count > 1 && n >= count);
    std::vector<double> near(n, HUGE_VAL), away(n);
    nb::gil_scoped_release release;
    for (size_t c = 0, next = 0; c < count; c++) {
        chosen.data()[c] = static_cast<int64_t>(next);
        std::fill(away.begin(), away.end(), 0.0);
        for (size_t j = 0; j < points.shape(0); j++) {
            const double *row = points.data() + j * n, at = row[next];
            for (size_t i = 0; i < n; i++) away[i] += (row[i] - at) * (row[i] - at);
        }
        for (size_t i = 0; i < n; i++) near[i] = std::min(near[i], away[i]);
        const auto top = std::max_element(near.begin(), near.end());
        next = c == 0 ? n - 1 : static_cast<size_t>(top - near.begin());
    }
}

// (a + rate b).H_r[x] along x.
void play_sum(Vector<double> x, Vector<double> rate, Vector<double> a, Vector<double> b, Vector<double> r, Output y,
              Output sums) {
    size_t n = r.shape(0), ticks = x.shape(0);
    require_lengths(rate.shape(0) == ticks && sums.shape(0) == ticks && a.shape(0) == n && b.shape(0) == n &&
                    y.shape(0) == n);
    std::vector<ts_real> thresholds = reals(r), state(y.data(), y.data() + n), weights(n);
    nb::gil_scoped_release release;
    for (size_t k = 0; k < ticks; k++) {
        ts_play_bank(static_cast<ts_real>(x.data()[k]), thresholds.data(), state.data(), static_cast<int>(n));
        for (size_t i = 0; i < n; i++) weights[i] = static_cast<ts_real>(a.data()[i] + rate.data()[k] * b.data()[i]);
        sums.data()[k] = ts_dot(weights.data(), state.data(), static_cast<int>(n));
    }
    std::copy(state.begin(), state.end(), y.data());
}

// The x for which play_sum gives y_d. Returns the first tick at which a partial sum is not above 0, or -1.
ptrdiff_t play_invert(Vector<double> y_d, Vector<double> rate, Vector<double> a, Vector<double> b, Vector<double> r,
                      Output y, Output x) {
    size_t n = r.shape(0), ticks = y_d.shape(0);
    require_lengths(rate.shape(0) == ticks && x.shape(0) == ticks && a.shape(0) == n && b.shape(0) == n &&
                    y.shape(0) == n);
    std::vector<ts_real> thresholds = reals(r), state(y.data(), y.data() + n), slopes(n);
    nb::gil_scoped_release release;
    for (size_t k = 0; k < ticks; k++) {
        double sum = 0;
        for (size_t i = 0; i < n; i++) {
            sum += a.data()[i] + rate.data()[k] * b.data()[i];
            if (!(sum > 0)) return static_cast<ptrdiff_t>(k);
            slopes[i] = static_cast<ts_real>(sum);
        }
        ts_real volts = ts_play_inverse(static_cast<ts_real>(y_d.data()[k]), slopes.data(), thresholds.data(),
                                        state.data(), static_cast<int>(n));
        ts_play_bank(volts, thresholds.data(), state.data(), static_cast<int>(n));
        x.data()[k] = volts;
    }
    std::copy(state.begin(), state.end(), y.data());
    return -1;
}

} // namespace

#define MODULE(name, variable) NB_MODULE(name, variable)
MODULE(TS_MODULE, m) {
    m.doc() = "The C kernel: play bank, inverse, recursive least squares, controller.";
    ts_variant_use(nullptr);
    m.def("variants", [] {
        std::vector<std::string> names;
        for (int i = 0; ts_variant_name(i); i++) names.push_back(ts_variant_name(i));
        return names;
    });
    m.def("variant", [] { return std::string(ts_variant_in_use()); });
    m.def("use_variant", [](const std::string &name) {
        if (!ts_variant_use(name.c_str())) throw std::invalid_argument("this processor has no kernel variant " + name);
    }, "name"_a);
    nb::list members;
#define MEMBER(name, member) members.append(name);
#include "ts_settings.inc"
#undef MEMBER
    m.attr("SETTINGS") = nb::tuple(members);
    m.attr("MAX_PLAYS") = TS_MAX_PLAYS;
    m.attr("MAX_DEAD_ZONES") = TS_MAX_DEAD_ZONES;
    m.attr("MAX_CREEPS") = TS_MAX_CREEPS;
    m.attr("MAX_DUHEM") = TS_MAX_DUHEM;
    m.attr("HISTORY") = TS_HISTORY;
    m.attr("REAL_BYTES") = sizeof(ts_real);
    m.def("play_history", &play_history, "x"_a, "r"_a, "y"_a, "every"_a, "rows"_a);
    m.def("respond_rows", &respond_rows, "columns"_a, "taps"_a, "sections"_a, "lag"_a, "dead"_a, "part"_a, "every"_a,
          "rows"_a);
    m.def("displacement", &displacement, "plays"_a, "known"_a, "weights"_a, "asymmetry"_a, "stroke"_a, "z"_a);
    m.def("duhem_states", &duhem_states, "s"_a, "betas"_a, "half"_a, "every"_a, "rows"_a);
    m.def("creep_rows", &creep_rows, "x"_a, "shares"_a, "rows"_a);
    m.def("farthest", &farthest, "points"_a, "chosen"_a);
    m.def("play_sum", &play_sum, "x"_a, "rate"_a, "a"_a, "b"_a, "r"_a, "y"_a, "sums"_a);
    m.def("play_invert", &play_invert, "y_d"_a, "rate"_a, "a"_a, "b"_a, "r"_a, "y"_a, "x"_a);
    nb::class_<Kernel> kernel(m, "Kernel");
    for (PyMethodDef &call : tick_calls)
        kernel.attr(call.ml_name) =
            nb::steal(PyDescr_NewMethod(reinterpret_cast<PyTypeObject *>(kernel.ptr()), &call));
    kernel
        .def(nb::init<const nb::dict &>(), "settings"_a)
        .def("start", &Kernel::start, "volts"_a, "z"_a)
        .def("change", &Kernel::change, "settings"_a)
        .def("process", &Kernel::process, "z_d"_a, "zdot_d"_a, "z_measured"_a.none(), "volts"_a, "ago"_a = 0)
        .def("native", &Kernel::native)
        .def("require_reach", &Kernel::require_reach)
        .def("reset", &Kernel::reset)
        .def("hold", &Kernel::hold, "on"_a)
        .def("state", &Kernel::state)
        .def("restore", &Kernel::restore, "state"_a)
        .def("weights", &Kernel::weights)
        .def("slopes", &Kernel::slopes)
        .def("play", &Kernel::play)
        .def("innovation", &Kernel::innovation)
        .def("trace", &Kernel::trace)
        .def("covariance", &Kernel::covariance)
        .def("noise", &Kernel::noise)
        .def("resonance", &Kernel::resonance)
        .def("load", &Kernel::load)
        .def("beyond", &Kernel::beyond)
        .def("filter", &Kernel::filter)
        .def("flags", &Kernel::flags)
        .def("counters", &Kernel::counters);
    nb::class_<Repetition>(m, "Repetition")
        .def(nb::init<const nb::dict &>(), "members"_a)
        .def("tick", &Repetition::tick, "z_d"_a)
        .def("trigger", &Repetition::trigger)
        .def("leave", &Repetition::leave)
        .def("become", &Repetition::become, "volts"_a.none(), "scale"_a = 1.0, "waits"_a = 0)
        .def("move", &Repetition::move, "volts"_a, "ticks"_a)
        .def("volts", &Repetition::volts, "inside"_a, "low"_a, "high"_a, "slew"_a)
        .def("see", &Repetition::see, "error"_a, "gain"_a = 0.0)
        .def("state", &Repetition::state)
        .def("restore", &Repetition::restore, "state"_a)
        .def("__getstate__", &Repetition::getstate)
        .def("__setstate__", &Repetition::setstate)
        .def_prop_ro("size", &Repetition::size)
        .def_prop_ro("at", &Repetition::at)
        .def_prop_ro("period", &Repetition::period)
        .def_prop_ro("goal", &Repetition::goal)
        .def_prop_ro("repeats", &Repetition::repeats)
        .def_prop_ro("joined", &Repetition::joined)
        .def_prop_ro("corrects", &Repetition::corrects)
        .def_prop_ro("slewed", &Repetition::slewed)
        .def_prop_ro("saturated", &Repetition::saturated)
        .def_prop_ro("limited", &Repetition::limited)
        .def_prop_ro("wave", &Repetition::wave);
}
