// Python's view of the C kernel: one class, compiled once for double and once for float.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "truestroke.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace {

template <typename T> using Vector = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

const char *message(ts_status status) {
    switch (status) {
        case TS_BAD_PLAYS: return "plays";
        case TS_BAD_THRESHOLDS: return "thresholds";
        case TS_BAD_DEAD_ZONES: return "dead_zone_thresholds";
        case TS_BAD_DEAD_ZONE_WEIGHTS: return "dead_zone_weights";
        case TS_BAD_WEIGHTS: return "initial_weights";
        case TS_BAD_RATE_SCALE: return "rate_scale";
        case TS_BAD_FORGETTING: return "forgetting";
        case TS_BAD_REGULARIZATION: return "regularization";
        case TS_BAD_COVARIANCE_LIMIT: return "covariance_limit";
        case TS_BAD_SLOPE: return "slope_min";
        case TS_BAD_VOLTAGE: return "voltage_limits";
        default: return "settings";
    }
}

void fill(ts_real *target, int capacity, const std::vector<double> &source, const char *name) {
    if (source.size() > static_cast<size_t>(capacity))
        throw std::invalid_argument(std::string(name) + " has " + std::to_string(source.size()) +
                                    " entries: the kernel holds at most " + std::to_string(capacity));
    for (size_t i = 0; i < source.size(); i++) target[i] = static_cast<ts_real>(source[i]);
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

class Kernel {
  public:
    Kernel(const std::vector<double> &thresholds, const std::vector<double> &dead_zone_thresholds,
           const std::vector<double> &dead_zone_weights, const std::vector<double> &initial_weights, double rate_scale,
           double forgetting, double regularization, double covariance_limit, double slope_min, double voltage_min,
           double voltage_max) {
        ts_settings s{};
        s.plays = static_cast<int>(thresholds.size());
        s.dead_zones = static_cast<int>(dead_zone_thresholds.size());
        fill(s.thresholds, TS_MAX_PLAYS, thresholds, "thresholds");
        fill(s.dead_zone_thresholds, TS_MAX_DEAD_ZONES, dead_zone_thresholds, "dead_zone_thresholds");
        fill(s.dead_zone_weights, TS_MAX_DEAD_ZONES, dead_zone_weights, "dead_zone_weights");
        fill(s.initial_weights, TS_MAX_PARAMETERS, initial_weights, "initial_weights");
        s.rate_scale = static_cast<ts_real>(rate_scale);
        s.forgetting = static_cast<ts_real>(forgetting);
        s.regularization = static_cast<ts_real>(regularization);
        s.covariance_limit = static_cast<ts_real>(covariance_limit);
        s.slope_min = static_cast<ts_real>(slope_min);
        s.voltage_min = static_cast<ts_real>(voltage_min);
        s.voltage_max = static_cast<ts_real>(voltage_max);
        ts_status status = ts_controller_init(&c_, &s);
        if (status != TS_OK) throw std::invalid_argument(std::string("the kernel refuses ") + message(status));
    }

    double command(double z_d, double zdot_d) {
        ts_real volts;
        if (ts_controller_command(&c_, static_cast<ts_real>(z_d), static_cast<ts_real>(zdot_d), &volts) != TS_OK) {
            require_finite("z_d", z_d, "um");
            require_finite("zdot_d", zdot_d, "um/s");
            throw std::invalid_argument("z_d or zdot_d is too large for the kernel's number type");
        }
        return volts;
    }

    void adapt(double z_measured, int ago) { ts_controller_adapt(&c_, static_cast<ts_real>(z_measured), ago); }

    void process(Vector<double> z_d, Vector<double> zdot_d, std::optional<Vector<double>> z_measured, Output volts,
                 int ago) {
        size_t n = volts.shape(0);
        if (z_d.shape(0) != n || zdot_d.shape(0) != n || (z_measured && z_measured->shape(0) != n))
            throw std::invalid_argument("z_d, zdot_d, z_measured and volts must have the same length");
        for (size_t k = 0; k < n; k++) { // all of them before any state changes
            require_finite("z_d", static_cast<ts_real>(z_d.data()[k]), "um");
            require_finite("zdot_d", static_cast<ts_real>(zdot_d.data()[k]), "um/s");
        }
        nb::gil_scoped_release release;
        for (size_t k = 0; k < n; k++) {
            ts_real x = 0;
            ts_controller_command(&c_, static_cast<ts_real>(z_d.data()[k]), static_cast<ts_real>(zdot_d.data()[k]), &x);
            volts.data()[k] = x;
            if (z_measured) ts_controller_adapt(&c_, static_cast<ts_real>(z_measured->data()[k]), ago);
        }
    }

    void reset() { ts_controller_reset(&c_); }
    void hold(bool on) { ts_controller_hold(&c_, on); }

    size_t plays() const { return static_cast<size_t>(c_.settings.plays); }
    size_t parameters() const { return 2 * plays(); }

    // Everything that a tick leaves behind, by name; restore() takes the same dictionary.
    nb::dict state() const {
        nb::dict d;
        size_t n = plays(), m = parameters();
        d["weights"] = copy_of(c_.w, {m});
        d["covariance_root"] = copy_of(c_.S, {m, m});
        d["play"] = copy_of(c_.play, {n});
        d["lagged_play"] = copy_of(c_.lagged_play, {n});
        d["slopes"] = copy_of(c_.slopes, {n});
        d["regressor"] = copy_of(c_.u, {m});
        d["history_volts"] = copy_of(c_.x, {TS_HISTORY});
        d["history_rate"] = copy_of(c_.zdot_d, {TS_HISTORY});
        const ts_real scalars[] = {c_.y_d, c_.innovation};
        d["scalars"] = copy_of(scalars, {2});
        const uint8_t flags[] = {c_.flags.saturated, c_.flags.projected, c_.flags.rejected, c_.hold};
        d["flags"] = copy_of(flags, {4});
        const uint64_t ticks[] = {c_.counters.commands,  c_.counters.adaptations, c_.counters.saturated,
                                  c_.counters.projected, c_.counters.rejected,    c_.lagged_tick};
        d["ticks"] = copy_of(ticks, {6});
        return d;
    }

    void restore(const nb::dict &d) {
        ts_controller next = c_; // so that a bad entry changes nothing
        size_t n = plays(), m = parameters();
        take(d, "weights", next.w, m);
        take(d, "covariance_root", next.S, m * m);
        take(d, "play", next.play, n);
        take(d, "lagged_play", next.lagged_play, n);
        take(d, "slopes", next.slopes, n);
        take(d, "regressor", next.u, m);
        take(d, "history_volts", next.x, TS_HISTORY);
        take(d, "history_rate", next.zdot_d, TS_HISTORY);
        ts_real scalars[2];
        take(d, "scalars", scalars, 2);
        next.y_d = scalars[0];
        next.innovation = scalars[1];
        uint8_t flags[4];
        take(d, "flags", flags, 4);
        next.hold = flags[3] != 0;
        next.flags = ts_flags{flags[0] != 0, flags[1] != 0, flags[2] != 0, next.hold};
        uint64_t ticks[6];
        take(d, "ticks", ticks, 6);
        next.counters = ts_counters{ticks[0], ticks[1], ticks[2], ticks[3], ticks[4]};
        next.lagged_tick = ticks[5];
        c_ = next;
    }

    nb::object weights() const { return copy_of(c_.w, {parameters()}); }
    nb::object slopes() const { return copy_of(c_.slopes, {plays()}); }
    nb::object play() const { return copy_of(c_.play, {plays()}); }
    double innovation() const { return c_.innovation; }
    double trace() const {
        double sum = 0;
        for (size_t i = 0; i < parameters() * parameters(); i++) sum += static_cast<double>(c_.S[i]) * c_.S[i];
        return sum;
    }
    int flags() const {
        return c_.flags.saturated | c_.flags.projected << 1 | c_.flags.rejected << 2 | c_.flags.held << 3;
    }
    nb::tuple counters() const {
        return nb::make_tuple(c_.counters.commands, c_.counters.adaptations, c_.counters.saturated,
                              c_.counters.projected, c_.counters.rejected);
    }

  private:
    template <typename T> static void take(const nb::dict &d, const char *name, T *target, size_t size) {
        if (!d.contains(name)) throw std::invalid_argument(std::string("state has no entry ") + name);
        nb::ndarray<const T, nb::c_contig, nb::device::cpu> source;
        if (!nb::try_cast(d[name], source) || source.size() != size)
            throw std::invalid_argument(std::string("state entry ") + name + " must have " + std::to_string(size) +
                                        " entries of the kernel's number type");
        for (size_t i = 0; i < size; i++)
            if constexpr (std::is_floating_point_v<T>)
                if (!std::isfinite(source.data()[i]))
                    throw std::invalid_argument(std::string("state entry ") + name + " is not finite");
        std::copy(source.data(), source.data() + size, target);
    }

    ts_controller c_{};
};

} // namespace

#define MODULE(name, variable) NB_MODULE(name, variable)
MODULE(TS_MODULE, m) {
    m.doc() = "The C kernel: play bank, inverse, recursive least squares, controller.";
    m.attr("MAX_PLAYS") = TS_MAX_PLAYS;
    m.attr("MAX_DEAD_ZONES") = TS_MAX_DEAD_ZONES;
    m.attr("HISTORY") = TS_HISTORY;
    m.attr("REAL_BYTES") = sizeof(ts_real);
    nb::class_<Kernel>(m, "Kernel")
        .def(nb::init<const std::vector<double> &, const std::vector<double> &, const std::vector<double> &,
                      const std::vector<double> &, double, double, double, double, double, double, double>(),
             nb::kw_only(), "thresholds"_a, "dead_zone_thresholds"_a, "dead_zone_weights"_a, "initial_weights"_a,
             "rate_scale"_a, "forgetting"_a, "regularization"_a, "covariance_limit"_a, "slope_min"_a, "voltage_min"_a,
             "voltage_max"_a)
        .def("command", &Kernel::command, "z_d"_a, "zdot_d"_a)
        .def("adapt", &Kernel::adapt, "z_measured"_a, "ago"_a = 0)
        .def("process", &Kernel::process, "z_d"_a, "zdot_d"_a, "z_measured"_a.none(), "volts"_a, "ago"_a = 0)
        .def("reset", &Kernel::reset)
        .def("hold", &Kernel::hold, "on"_a)
        .def("state", &Kernel::state)
        .def("restore", &Kernel::restore, "state"_a)
        .def("weights", &Kernel::weights)
        .def("slopes", &Kernel::slopes)
        .def("play", &Kernel::play)
        .def("innovation", &Kernel::innovation)
        .def("trace", &Kernel::trace)
        .def("flags", &Kernel::flags)
        .def("counters", &Kernel::counters);
}
