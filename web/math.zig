//! The mathematical functions of C that compiler_rt has not, so that no C library is compiled for the module.
const math = @import("std").math;

export fn expm1(x: f64) f64 {
    return math.expm1(x);
}
export fn log1p(x: f64) f64 {
    return math.log1p(x);
}
export fn pow(x: f64, y: f64) f64 {
    return math.pow(f64, x, y);
}
