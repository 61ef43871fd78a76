/* Which settings a status of ts_controller_init or ts_controller_change complains of, for messages. */
#ifndef TRUESTROKE_STATUS_H
#define TRUESTROKE_STATUS_H

#include "truestroke.h"

static inline const char *ts_status_setting(ts_status status)
{
    switch (status) {
        case TS_BAD_PLAYS: return "plays";
        case TS_BAD_THRESHOLDS: return "thresholds";
        case TS_BAD_DEAD_ZONES: return "dead_zone_thresholds";
        case TS_BAD_DEAD_ZONE_WEIGHTS: return "dead_zone_weights";
        case TS_BAD_TERMS: return "the terms of the model";
        case TS_BAD_WEIGHTS: return "initial_weights";
        case TS_BAD_RATE_SCALE: return "rate_scale";
        case TS_BAD_RLS: return "forgetting, regularization or covariance_limit";
        case TS_BAD_KALMAN: return "the settings of the Kalman filter";
        case TS_BAD_SLOPE: return "slope_limits";
        case TS_BAD_VOLTAGE: return "voltage_limits or slew_limit";
        case TS_BAD_SENSOR: return "the sensor";
        case TS_BAD_DYNAMICS: return "dynamics";
        case TS_BAD_HUM: return "the lines of hum";
        case TS_BAD_FEEDBACK: return "the feedback";
        case TS_BAD_LIMIT: return "stroke, measurement_limit, smoothing or trim";
        default: return "settings";
    }
}

#endif
