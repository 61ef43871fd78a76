// Python's view of the native loops over ticks: the GIL is released while they run.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <stdexcept>
#include <vector>

#include "loops.h"
#include "native.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace {

using Input = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Bits = nb::ndarray<uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Pairs = nb::ndarray<const double, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;
using OutputPairs = nb::ndarray<double, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;

void require(bool fits) {
    if (!fits) throw std::invalid_argument("the arrays of a loop have different lengths");
}

void run(nb::handle controller, nb::handle actuator, Input z_d, Input zdot_d, std::optional<Input> zddot_d,
         std::optional<Input> strain_d, Input noise, Output volts,
         Output measured, Output truth, Output innovation, Bits flags) {
    const auto &c = from_capsule<ts_loop_controller>("ts_loop_controller", controller);
    const auto &a = from_capsule<ts_loop_actuator>("ts_loop_actuator", actuator);
    size_t n = z_d.shape(0);
    require(zdot_d.shape(0) == n && volts.shape(0) == n && measured.shape(0) == n && truth.shape(0) == n &&
            innovation.shape(0) == n && flags.shape(0) == n && noise.shape(0) == n * a.noise_per_tick);
    require((!zddot_d || zddot_d->shape(0) == n) && (!strain_d || strain_d->shape(0) == n));
    ts_loop_channels ch{z_d.data(),   zdot_d.data(), zddot_d ? zddot_d->data() : nullptr, strain_d ? strain_d->data() : nullptr,
                        noise.data(), volts.data(),  measured.data(),                     truth.data(),
                        innovation.data(), flags.data()};
    nb::gil_scoped_release release;
    ts_loop_run(&c, &a, &ch, n);
}

// One row a tick, an entry for each axis.
using Rows = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using BitRows = nb::ndarray<uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Known = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void run_axes(const std::vector<nb::object> &controllers, nb::handle actuator, Known motion, Known strain_d, Known others,
              Known to_axes, Input noise, Rows volts, Rows measured, Rows truth, Rows innovation, BitRows flags) {
    const auto &a = from_capsule<ts_loop_axes>("ts_loop_axes", actuator);
    std::vector<ts_loop_controller> c;
    for (const nb::object &one : controllers) c.push_back(from_capsule<ts_loop_controller>("ts_loop_controller", one));
    size_t n = motion.shape(0), axes = a.axes;
    require(c.size() == axes && axes <= TS_LOOP_MAX_AXES && to_axes.shape(0) == axes && to_axes.shape(1) == axes);
    require(noise.shape(0) == n * a.noise_per_tick && motion.shape(1) == 3 * axes && strain_d.shape(0) == n &&
            strain_d.shape(1) == axes && others.shape(0) == n && others.shape(1) == 3 * axes * (axes - 1));
    for (const Rows &rows : {volts, measured, truth, innovation}) require(rows.shape(0) == n && rows.shape(1) == axes);
    require(flags.shape(0) == n && flags.shape(1) == axes);
    ts_loop_axes_channels ch{motion.data(), strain_d.data(), others.data(), to_axes.data(), noise.data(), volts.data(),
                             measured.data(), truth.data(), innovation.data(), flags.data()};
    nb::gil_scoped_release release;
    ts_loop_run_axes(c.data(), &a, &ch, n);
}

void first_order(double real, double imaginary, Pairs u, OutputPairs x) {
    require(u.shape(0) + 1 == x.shape(0));
    double decay[2] = {real, imaginary};
    nb::gil_scoped_release release;
    ts_first_order(decay, u.data(), x.data(), u.shape(0));
}

} // namespace

NB_MODULE(_loops, m) {
    m.doc() = "Loops over ticks: a native controller against a native actuator, and the filter of the random waves.";
    m.def("run", &run, "controller"_a, "actuator"_a, "z_d"_a, "zdot_d"_a, "zddot_d"_a.none(),
          "strain_d"_a.none(), "noise"_a, "volts"_a, "measured"_a,
          "truth"_a, "innovation"_a, "flags"_a);
    m.def("run_axes", &run_axes, "controllers"_a, "actuator"_a, "motion"_a, "strain_d"_a, "others"_a, "to_axes"_a,
          "noise"_a, "volts"_a, "measured"_a, "truth"_a, "innovation"_a, "flags"_a);
    m.def("first_order", &first_order, "real"_a, "imaginary"_a, "u"_a, "x"_a);
}
