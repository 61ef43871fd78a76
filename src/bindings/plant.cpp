// Python's view of the simulated actuators: settings by name, arrays that the caller owns.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <cstring>
#include <new>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "axes.h"
#include "loops.h"
#include "native.h"
#include "plant.h"
#include "settings.h"
#include "stage.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace {

using Input = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

void within(const char *name, int value, int low, int high) {
    if (value < low || value > high)
        throw std::invalid_argument(std::string(name) + " must be from " + std::to_string(low) + " to " +
                                    std::to_string(high));
}

void same_length(size_t expected, size_t given) {
    if (expected != given) throw std::invalid_argument("the arrays of an exchange have different lengths");
}

// A plant as bytes and back: the structs are plain data. Only what `pickled` gave may come back.
template <typename T> nb::bytes pickled(const T &plant) {
    static_assert(std::is_trivially_copyable_v<T>);
    return nb::bytes(reinterpret_cast<const char *>(&plant), sizeof plant);
}

template <typename T> void unpickle(T &place, const nb::bytes &bytes) {
    if (bytes.size() != sizeof(T)) throw std::invalid_argument("the plant was pickled by another version");
    std::memcpy(static_cast<void *>(&place), bytes.c_str(), sizeof(T));
}

// Index of the first entry that is not finite, or -1: asked before anything moves.
int64_t first_bad(const Input &volts) {
    for (size_t k = 0; k < volts.shape(0); k++)
        if (!std::isfinite(volts.data()[k])) return static_cast<int64_t>(k);
    return -1;
}

ts_plant_settings plant_settings(const nb::dict &d) {
    ts_plant_settings s{};
    Reader read(d);
#define MEMBER(name, member) read(name, s.member);
#include "ts_plant_settings.inc"
#undef MEMBER
    read.finish();
    within("samples_per_tick", s.samples_per_tick, 1, 1 << 20);
    within("steps_per_tick", s.steps_per_tick, s.samples_per_tick, 1 << 20);
    within("plays", s.plays, 1, TS_PLANT_MAX_PLAYS);
    within("creep_operators", s.creep_operators, 1, TS_PLANT_MAX_CREEP);
    return s;
}

class Plant {
  public:
    explicit Plant(const nb::dict &d) : settings_(plant_settings(d)) { reset(); }

    void reset() { ts_plant_init(&p_, &settings_); }

    int64_t run(const Input &volts, const Input &noise, const Output &measured, const Output &truth) {
        size_t n = volts.shape(0);
        same_length(n * static_cast<size_t>(settings_.samples_per_tick), noise.shape(0));
        same_length(n, measured.shape(0));
        same_length(n, truth.shape(0));
        int64_t bad = first_bad(volts);
        if (bad >= 0) return bad;
        nb::gil_scoped_release release;
        ts_plant_run(&p_, volts.data(), noise.data(), measured.data(), truth.data(), n);
        return -1;
    }

    // This plant as the native loop calls it.
    static nb::capsule native(nb::object self) {
        Plant *plant = nb::inst_ptr<Plant>(self);
        ts_loop_actuator calls{
            plant, static_cast<size_t>(plant->settings_.samples_per_tick),
            [](void *p, double volts, double, const double *noise, double *measured, double *truth) {
                ts_plant_run(&static_cast<Plant *>(p)->p_, &volts, noise, measured, truth, 1);
            }};
        return in_capsule("ts_loop_actuator", calls, self);
    }

  private:
    ts_plant_settings settings_;
    ts_plant p_{};
};

ts_matched_settings matched_settings(const nb::dict &d) {
    ts_matched_settings s{};
    Reader read(d);
#define MEMBER(name, member) read(name, s.member);
#include "ts_matched_settings.inc"
#undef MEMBER
    read.finish();
    within("plays", s.plays, 1, TS_MATCHED_MAX_PLAYS);
    within("dead_zones", s.dead_zones, 1, TS_MATCHED_MAX_DEAD_ZONES);
    return s;
}

class Matched {
  public:
    explicit Matched(const nb::dict &d) : settings_(matched_settings(d)) { reset(); }

    void reset() { ts_matched_init(&m_, &settings_); }

    int64_t run(const Input &volts, const Input &velocity, const Input &noise, const Output &measured,
                const Output &truth) {
        size_t n = volts.shape(0);
        same_length(n, velocity.shape(0));
        same_length(n, noise.shape(0));
        same_length(n, measured.shape(0));
        same_length(n, truth.shape(0));
        int64_t bad = first_bad(volts);
        if (bad >= 0) return bad;
        nb::gil_scoped_release release;
        ts_matched_run(&m_, volts.data(), velocity.data(), noise.data(), measured.data(), truth.data(), n);
        return -1;
    }

    // This plant as the native loop calls it.
    static nb::capsule native(nb::object self) {
        ts_loop_actuator calls{
            nb::inst_ptr<Matched>(self), 1,
            [](void *m, double volts, double velocity, const double *noise, double *measured, double *truth) {
                ts_matched_run(&static_cast<Matched *>(m)->m_, &volts, &velocity, noise, measured, truth, 1);
            }};
        return in_capsule("ts_loop_actuator", calls, self);
    }

  private:
    ts_matched_settings settings_;
    ts_matched m_{};
};

ts_stage_settings stage_settings(const nb::dict &d) {
    ts_stage_settings s{};
    Reader read(d);
#define MEMBER(name, member) read(name, s.member);
#include "ts_stage_settings.inc"
#undef MEMBER
    read.finish();
    within("samples_per_tick", s.samples_per_tick, 1, TS_STAGE_MAX_STEPS / 2);
    within("steps_per_tick", s.steps_per_tick, 2 * s.samples_per_tick, TS_STAGE_MAX_STEPS);
    within("plays", s.plays, 1, TS_STAGE_MAX_PLAYS);
    within("creep_operators", s.creep_operators, 1, TS_STAGE_MAX_CREEP);
    within("modes", s.modes, 1, TS_STAGE_MAX_MODES);
    for (double delay : {s.dead_time, s.sensor_delay})
        if (!(delay >= 0 && delay * s.sample_rate <= TS_STAGE_MAX_DELAY))
            throw std::invalid_argument("a delay must be from 0 to 20 ticks");
    return s;
}

// A stage and the load of each tick; the load is 0 after its last entry.
class Stage {
  public:
    Stage(const nb::dict &d, const Input &load)
        : settings_(stage_settings(d)), load_(load.data(), load.data() + load.shape(0)) {
        reset();
    }

    void reset() { ts_stage_init(&p_, &settings_); }

    double least_slope() const { return p_.least_slope; }

    int64_t run(const Input &volts, const Input &noise, const Output &measured, const Output &truth) {
        size_t n = volts.shape(0);
        same_length(n * static_cast<size_t>(settings_.samples_per_tick), noise.shape(0));
        same_length(n, measured.shape(0));
        same_length(n, truth.shape(0));
        int64_t bad = first_bad(volts);
        if (bad >= 0) return bad;
        nb::gil_scoped_release release;
        for (size_t k = 0; k < n; k++)
            tick(volts.data()[k], noise.data() + k * static_cast<size_t>(settings_.samples_per_tick),
                 measured.data() + k, truth.data() + k);
        return -1;
    }

    // This stage as the native loop calls it.
    static nb::capsule native(nb::object self) {
        Stage *stage = nb::inst_ptr<Stage>(self);
        ts_loop_actuator calls{
            stage, static_cast<size_t>(stage->settings_.samples_per_tick),
            [](void *p, double volts, double, const double *noise, double *measured, double *truth) {
                static_cast<Stage *>(p)->tick(volts, noise, measured, truth);
            }};
        return in_capsule("ts_loop_actuator", calls, self);
    }

    // As bytes and back; only what `state` gave may come back.
    nb::tuple state() const {
        const auto *load = reinterpret_cast<const char *>(load_.data());
        return nb::make_tuple(pickled(settings_), pickled(p_), nb::bytes(load, load_.size() * sizeof(double)));
    }

    explicit Stage(const nb::tuple &state) {
        unpickle(settings_, nb::cast<nb::bytes>(state[0]));
        unpickle(p_, nb::cast<nb::bytes>(state[1]));
        auto load = nb::cast<nb::bytes>(state[2]);
        load_.resize(load.size() / sizeof(double));
        if (!load_.empty()) std::memcpy(load_.data(), load.c_str(), load_.size() * sizeof(double));
    }

  private:
    void tick(double volts, const double *noise, double *measured, double *truth) {
        const double *load = p_.tick < load_.size() ? &load_[p_.tick] : nullptr;
        ts_stage_run(&p_, &volts, load, noise, measured, truth, 1);
    }

    ts_stage_settings settings_;
    std::vector<double> load_;
    ts_stage p_{};
};

// Several stages that disturb each other.
class Axes {
  public:
    Axes(const std::vector<nb::dict> &stages, const nb::dict &d) {
        Reader read(d);
#define MEMBER(name, member) read(name, settings_.member);
#include "ts_axes_settings.inc"
#undef MEMBER
        read.finish();
        within("axes", settings_.axes, 2, TS_AXES_MAX);
        same_length(static_cast<size_t>(settings_.axes), stages.size());
        for (size_t i = 0; i < stages.size(); i++) {
            stages_[i] = stage_settings(stages[i]);
            within("steps_per_tick", stages_[i].steps_per_tick, stages_[0].steps_per_tick, stages_[0].steps_per_tick);
            within("samples_per_tick", stages_[i].samples_per_tick, stages_[0].samples_per_tick, stages_[0].samples_per_tick);
        }
        reset();
    }

    void reset() { ts_axes_init(&p_, &settings_, stages_); }

    std::vector<double> least_slopes() const {
        std::vector<double> slopes;
        for (int i = 0; i < settings_.axes; i++) slopes.push_back(p_.stage[i].least_slope);
        return slopes;
    }

    // As Stage::run, of arrays that hold the entries of all axes of a tick, then those of the next one.
    int64_t run(const Input &volts, const Input &noise, const Output &measured, const Output &truth) {
        size_t n = volts.shape(0), axes = static_cast<size_t>(settings_.axes);
        same_length(n * static_cast<size_t>(stages_[0].samples_per_tick), noise.shape(0));
        same_length(n, n / axes * axes);
        same_length(n, measured.shape(0));
        same_length(n, truth.shape(0));
        int64_t bad = first_bad(volts);
        if (bad >= 0) return bad;
        nb::gil_scoped_release release;
        ts_axes_run(&p_, volts.data(), noise.data(), measured.data(), truth.data(), n / axes);
        return -1;
    }

    // These stages as the native loop calls them.
    static nb::capsule native(nb::object self) {
        Axes *axes = nb::inst_ptr<Axes>(self);
        size_t n = static_cast<size_t>(axes->settings_.axes);
        ts_loop_axes calls{axes, n, n * static_cast<size_t>(axes->stages_[0].samples_per_tick),
                           [](void *p, const double *volts, const double *noise, double *measured, double *truth) {
                               ts_axes_run(&static_cast<Axes *>(p)->p_, volts, noise, measured, truth, 1);
                           }};
        return in_capsule("ts_loop_axes", calls, self);
    }

  private:
    ts_axes_settings settings_{};
    ts_stage_settings stages_[TS_AXES_MAX]{};
    ts_axes p_{};
};

} // namespace

NB_MODULE(_plant, m) {
    nb::set_leak_warnings(false); // a plant that lives until the interpreter ends, as in a notebook, is no leak
    m.doc() = "The simulated actuators in C: the realistic plant, the matched plant (13) and the stage for fast motion.";
    m.attr("MAX_PLAYS") = TS_PLANT_MAX_PLAYS;
    m.attr("MAX_CREEP_OPERATORS") = TS_PLANT_MAX_CREEP;
    m.attr("STAGE_MAX_PLAYS") = TS_STAGE_MAX_PLAYS;
    m.attr("STAGE_MAX_CREEP_OPERATORS") = TS_STAGE_MAX_CREEP;
    m.attr("STAGE_MAX_MODES") = TS_STAGE_MAX_MODES;
    m.attr("STAGE_MAX_STEPS") = TS_STAGE_MAX_STEPS;
    m.attr("STAGE_MAX_DELAY") = TS_STAGE_MAX_DELAY;
    m.attr("MAX_AXES") = TS_AXES_MAX;
    m.attr("MATCHED_MAX_PLAYS") = TS_MATCHED_MAX_PLAYS;
    m.attr("MATCHED_MAX_DEAD_ZONES") = TS_MATCHED_MAX_DEAD_ZONES;
    nb::class_<Plant>(m, "Plant")
        .def(nb::init<const nb::dict &>(), "settings"_a)
        .def("__getstate__", &pickled<Plant>)
        .def("__setstate__", &unpickle<Plant>)
        .def("native", &Plant::native)
        .def("reset", &Plant::reset)
        .def("run", &Plant::run, "volts"_a, "noise"_a, "measured"_a, "truth"_a);
    nb::class_<Matched>(m, "Matched")
        .def(nb::init<const nb::dict &>(), "settings"_a)
        .def("__getstate__", &pickled<Matched>)
        .def("__setstate__", &unpickle<Matched>)
        .def("native", &Matched::native)
        .def("reset", &Matched::reset)
        .def("run", &Matched::run, "volts"_a, "velocity"_a, "noise"_a, "measured"_a, "truth"_a);
    nb::class_<Axes>(m, "Axes")
        .def(nb::init<const std::vector<nb::dict> &, const nb::dict &>(), "stages"_a, "axes"_a)
        .def("__getstate__", &pickled<Axes>)
        .def("__setstate__", &unpickle<Axes>)
        .def_prop_ro("least_slopes", &Axes::least_slopes)
        .def("native", &Axes::native)
        .def("reset", &Axes::reset)
        .def("run", &Axes::run, "volts"_a, "noise"_a, "measured"_a, "truth"_a);
    nb::class_<Stage>(m, "Stage")
        .def(nb::init<const nb::dict &, const Input &>(), "settings"_a, "load"_a)
        .def("__getstate__", &Stage::state)
        .def("__setstate__", [](Stage &stage, const nb::tuple &state) { new (&stage) Stage(state); })
        .def_prop_ro("least_slope", &Stage::least_slope)
        .def("native", &Stage::native)
        .def("reset", &Stage::reset)
        .def("run", &Stage::run, "volts"_a, "noise"_a, "measured"_a, "truth"_a);
}
