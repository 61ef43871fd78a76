// Times rls::train of dlib, 16 parameters, step by step. Arguments: file of rows (y, u[0], ..., u[15]), rows.
// Prints the ns of each step as a JSON array. Compiled by rivals.py where libdlib-dev is installed.
#include <dlib/assert.h>
#include <dlib/test_for_odr_violations.h>
#undef DLIB_USE_BLAS // for 16 parameters its own loops are faster than a call of BLAS
#include <dlib/filtering.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <vector>

int main(int, char **argv) {
    const long parameters = 16, steps = std::atol(argv[2]);
    std::vector<double> rows(static_cast<size_t>(steps * (parameters + 1)));
    std::ifstream(argv[1], std::ios::binary)
        .read(reinterpret_cast<char *>(rows.data()), static_cast<std::streamsize>(rows.size() * sizeof(double)));
    using clock = std::chrono::steady_clock;
    auto ns = [](clock::time_point a, clock::time_point b) {
        return static_cast<double>(std::chrono::duration_cast<std::chrono::nanoseconds>(b - a).count());
    };
    std::vector<double> empty, taken;
    for (int i = 0; i < 10000; i++) {
        auto before = clock::now();
        empty.push_back(ns(before, clock::now()));
    }
    std::nth_element(empty.begin(), empty.begin() + 5000, empty.end());
    const double cost = empty[5000];
    dlib::rls law(0.9999, 1e3, true); // the regularisation is forgotten too, as in (23)
    dlib::matrix<double, 16, 1> u;
    for (long k = 0; k < steps; k++) {
        const double *row = &rows[static_cast<size_t>(k * (parameters + 1))];
        for (long i = 0; i < parameters; i++) u(i) = row[i + 1];
        auto before = clock::now();
        law.train(u, row[0]);
        taken.push_back(std::max(0.0, ns(before, clock::now()) - cost));
    }
    std::printf("[");
    for (long k = 0; k < steps; k++) std::printf(k ? ",%.0f" : "%.0f", taken[static_cast<size_t>(k)]);
    std::printf("]\n");
}
