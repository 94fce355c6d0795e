// SPDX-License-Identifier: Apache-2.0
/// The feed-forward as an FMI 3.0 model, for Model Exchange and Co-Simulation: the wrench that a wanted motion takes with the
/// parameters at its inputs, and the tensions that give it. The model has no state; its robot is resources/robot.cfg.
///
/// Variables by value reference, as `inertiactl export --to fmu` writes them into modelDescription.xml:
///   0 time   1 p [3]   2 q [4]   3 a [3]   4 w [3]   5 alpha [3]   6 theta [10]   7 wrench [6]   8 tension [m]   9 feasible
/// Units and frames: feed_forward.h; q: quaternion w x y z, P to W, normalised here. Several instances may live at a time,
/// each is used by one thread at a time. Header files of FMI: fmpy's, Modelica Association, BSD 2-clause.
#include <inertiad/feed_forward.hpp>

#include <Eigen/Geometry>
#include <fmi3Functions.h>

#include <array>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstring>
#include <exception>
#include <new>
#include <optional>
#include <string>

namespace {

enum Reference : fmi3ValueReference { TIME, P, Q, A, W, ALPHA, THETA, WRENCH, TENSION, FEASIBLE, REFERENCES };

struct Values {
    double time = 0.0;
    std::array<double, 3> p{}, a{}, w{}, alpha{};
    std::array<double, 4> q{1.0, 0.0, 0.0, 0.0};
    std::array<double, IPE_NP> theta{};
};

struct Instance {
    Values in;
    Values at_start;  ///< the prior's body, at rest; for fmi3Reset
    std::array<double, IPE_NY> wrench{};
    inertiad::Tensions tension;
    bool is_feasible = false, is_due = true;
    std::optional<inertiad::Config> config;
    fmi3InstanceEnvironment environment = nullptr;
    fmi3LogMessageCallback log = nullptr;
};

__attribute__((format(printf, 2, 3))) fmi3Status fail(const Instance& i, const char* format, ...)
{
    std::array<char, 512> text{};
    va_list arguments;
    va_start(arguments, format);
    (void)std::vsnprintf(text.data(), text.size(), format, arguments);
    va_end(arguments);
    if (i.log != nullptr) { i.log(i.environment, fmi3Error, "error", text.data()); }
    return fmi3Error;
}

Instance& of(fmi3Instance instance)
{
    return *static_cast<Instance*>(instance);
}

/// The numbers of an input; size 0: it is none.
double* input(Values& v, fmi3ValueReference reference, std::size_t& size)
{
    switch (reference) {
    case P: size = v.p.size(); return v.p.data();
    case Q: size = v.q.size(); return v.q.data();
    case A: size = v.a.size(); return v.a.data();
    case W: size = v.w.size(); return v.w.data();
    case ALPHA: size = v.alpha.size(); return v.alpha.data();
    case THETA: size = v.theta.size(); return v.theta.data();
    default: size = 0; return nullptr;
    }
}

/// The numbers of a variable of type Float64, outputs as last computed.
const double* variable(Instance& i, fmi3ValueReference reference, std::size_t& size)
{
    switch (reference) {
    case TIME: size = 1; return &i.in.time;
    case WRENCH: size = i.wrench.size(); return i.wrench.data();
    case TENSION: size = static_cast<std::size_t>(i.tension.size()); return i.tension.data();
    default: return input(i.in, reference, size);
    }
}

fmi3Status compute(Instance& i)
{
    using inertiad::Vector3;
    if (!i.is_due) { return fmi3OK; }
    const Eigen::Quaterniond q(i.in.q[0], i.in.q[1], i.in.q[2], i.in.q[3]);
    if (!(q.norm() > 0.0) || !std::isfinite(q.norm())) { return fail(i, "q: must be a quaternion, not 0"); }
    const inertiad::Matrix3 R = q.normalized().toRotationMatrix();
    const Eigen::Map<const Vector3> p(i.in.p.data()), a(i.in.a.data()), w(i.in.w.data()), alpha(i.in.alpha.data());
    const inertiad::Theta theta = Eigen::Map<const inertiad::Theta>(i.in.theta.data());
    try {
        const inertiad::Vector6 wrench = inertiad::feed_forward(theta, R, a, w, alpha, i.config->c().gravity);
        Eigen::Map<inertiad::Vector6>(i.wrench.data()) = wrench;
        i.is_feasible = inertiad::feed_forward_tensions(*i.config, wrench, theta[0], p, R, i.tension);
    } catch (const std::exception& error) {
        return fail(i, "p, q: %s", error.what());
    }
    i.is_due = false;
    return fmi3OK;
}

/// The robot and the values at the start. False: logged why not.
bool load(Instance& i, const char* resources)
{
    std::string path = resources == nullptr ? "" : resources;
    if (!path.empty() && path.back() != '/') { path += '/'; }
    path += "robot.cfg";
    try {
        i.config = inertiad::Config::load(path);
    } catch (const std::invalid_argument& error) {
        (void)fail(i, "%s", error.what());
        return false;
    }
    const ipe_config_t& c = i.config->c();
    if (c.n_cables < 6) {
        (void)fail(i, "%s: %d cables: allowed: 6 or more, fewer cannot give every wrench", path.c_str(), c.n_cables);
        return false;
    }
    std::memcpy(i.in.theta.data(), c.prior_theta, sizeof c.prior_theta);
    for (int cable = 0; cable < c.n_cables; ++cable) {
        for (std::size_t k = 0; k < 3; ++k) { i.in.p[k] += c.cable[cable].anchor[k] / c.n_cables; }
    }
    i.in.p[2] *= 0.5;  // between the floor and the anchors
    i.at_start = i.in;
    i.tension = inertiad::Tensions::Zero(c.n_cables);
    return true;
}

fmi3Instance instantiate(const char* token, const char* resources, fmi3InstanceEnvironment environment,
                         fmi3LogMessageCallback log)
{
    auto* i = new (std::nothrow) Instance;
    if (i == nullptr) { return nullptr; }
    i->environment = environment, i->log = log;
    const bool is_ours = token != nullptr && std::strcmp(token, INERTIAD_FMU_TOKEN) == 0;
    if (!is_ours) { (void)fail(*i, "instantiationToken: of another version of this model"); }
    if (is_ours && load(*i, resources)) { return i; }
    delete i;
    return nullptr;
}

}  // namespace

extern "C" {

const char* fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance, fmi3Boolean, size_t, const fmi3String[])
{
    return fmi3OK;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String, fmi3String token, fmi3String resources, fmi3Boolean, fmi3Boolean,
                                          fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    return instantiate(token, resources, environment, log);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String, fmi3String token, fmi3String resources, fmi3Boolean, fmi3Boolean,
                                         fmi3Boolean, fmi3Boolean, const fmi3ValueReference[], size_t,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback)
{
    return instantiate(token, resources, environment, log);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback, fmi3LockPreemptionCallback,
                                               fmi3UnlockPreemptionCallback)
{
    if (log != nullptr) { log(environment, fmi3Error, "error", "the model has no scheduled execution"); }
    return nullptr;
}

void fmi3FreeInstance(fmi3Instance instance)
{
    delete static_cast<Instance*>(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean, fmi3Float64, fmi3Float64 start, fmi3Boolean,
                                       fmi3Float64)
{
    of(instance).in.time = start;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return compute(of(instance));
}

fmi3Status fmi3EnterEventMode(fmi3Instance)
{
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance)
{
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    of(instance).in = of(instance).at_start;
    of(instance).is_due = true;
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n, fmi3Float64 values[],
                          size_t n_values)
{
    Instance& i = of(instance);
    size_t at = 0;
    for (size_t k = 0; k < n; ++k) {
        std::size_t size = 0;
        if (references[k] >= WRENCH && compute(i) != fmi3OK) { return fmi3Error; }
        const double* from = variable(i, references[k], size);
        if (size == 0) { return fail(i, "value reference %u is no Float64", references[k]); }
        if (at + size > n_values) { return fail(i, "value reference %u has %zu values", references[k], size); }
        std::memcpy(values + at, from, size * sizeof(double));
        at += size;
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                          const fmi3Float64 values[], size_t n_values)
{
    Instance& i = of(instance);
    size_t at = 0;
    for (size_t k = 0; k < n; ++k) {
        std::size_t size = 0;
        double* to = input(i.in, references[k], size);
        if (size == 0) { return fail(i, "value reference %u is no input of type Float64", references[k]); }
        if (at + size > n_values) { return fail(i, "value reference %u has %zu values", references[k], size); }
        std::memcpy(to, values + at, size * sizeof(double));
        at += size;
    }
    i.is_due = true;
    return fmi3OK;
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference references[], size_t n, fmi3Boolean values[],
                          size_t n_values)
{
    Instance& i = of(instance);
    for (size_t k = 0; k < n; ++k) {
        if (references[k] != FEASIBLE || k >= n_values) { return fail(i, "%u is no Boolean", references[k]); }
        if (compute(i) != fmi3OK) { return fmi3Error; }
        values[k] = i.is_feasible;
    }
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance, fmi3Boolean* need_update, fmi3Boolean* terminate,
                                    fmi3Boolean* nominals_changed, fmi3Boolean* states_changed, fmi3Boolean* has_next,
                                    fmi3Float64* next)
{
    *need_update = *terminate = *nominals_changed = *states_changed = *has_next = fmi3False;
    *next = 0.0;
    return fmi3OK;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance)
{
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance, fmi3Boolean, fmi3Boolean* enter_event_mode, fmi3Boolean* terminate)
{
    *enter_event_mode = *terminate = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    of(instance).in.time = time;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance, size_t* n)
{
    *n = 0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance, size_t* n)
{
    *n = 0;
    return fmi3OK;
}

fmi3Status fmi3EnterStepMode(fmi3Instance)
{
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 now, fmi3Float64 step, fmi3Boolean,
                      fmi3Boolean* event_handling_needed, fmi3Boolean* terminate, fmi3Boolean* early_return,
                      fmi3Float64* last_time)
{
    *event_handling_needed = *terminate = *early_return = fmi3False;
    of(instance).in.time = *last_time = now + step;
    return compute(of(instance));
}

// ---- parts of FMI that a model without states, clocks and other types has no use for -------------------------------------

#define NO_VALUES(TYPE)                                                                                      \
    fmi3Status fmi3Get##TYPE(fmi3Instance, const fmi3ValueReference[], size_t n, fmi3##TYPE[], size_t)       \
    {                                                                                                        \
        return n == 0 ? fmi3OK : fmi3Error;                                                                  \
    }                                                                                                        \
    fmi3Status fmi3Set##TYPE(fmi3Instance, const fmi3ValueReference[], size_t n, const fmi3##TYPE[], size_t) \
    {                                                                                                        \
        return n == 0 ? fmi3OK : fmi3Error;                                                                  \
    }
NO_VALUES(Float32)
NO_VALUES(Int8)
NO_VALUES(UInt8)
NO_VALUES(Int16)
NO_VALUES(UInt16)
NO_VALUES(Int32)
NO_VALUES(UInt32)
NO_VALUES(Int64)
NO_VALUES(UInt64)
NO_VALUES(String)

#define NOT_SUPPORTED(NAME, ...)              \
    fmi3Status NAME(fmi3Instance __VA_ARGS__) \
    {                                         \
        return fmi3Error;                     \
    }
#define AND(...) , __VA_ARGS__
NOT_SUPPORTED(fmi3SetBoolean, AND(const fmi3ValueReference[], size_t, const fmi3Boolean[], size_t))
NOT_SUPPORTED(fmi3GetBinary, AND(const fmi3ValueReference[], size_t, size_t[], fmi3Binary[], size_t))
NOT_SUPPORTED(fmi3SetBinary, AND(const fmi3ValueReference[], size_t, const size_t[], const fmi3Binary[], size_t))
NOT_SUPPORTED(fmi3GetClock, AND(const fmi3ValueReference[], size_t, fmi3Clock[]))
NOT_SUPPORTED(fmi3SetClock, AND(const fmi3ValueReference[], size_t, const fmi3Clock[]))
NOT_SUPPORTED(fmi3GetNumberOfVariableDependencies, AND(fmi3ValueReference, size_t*))
NOT_SUPPORTED(fmi3GetVariableDependencies,
              AND(fmi3ValueReference, size_t[], fmi3ValueReference[], size_t[], fmi3DependencyKind[], size_t))
NOT_SUPPORTED(fmi3GetFMUState, AND(fmi3FMUState*))
NOT_SUPPORTED(fmi3SetFMUState, AND(fmi3FMUState))
NOT_SUPPORTED(fmi3FreeFMUState, AND(fmi3FMUState*))
NOT_SUPPORTED(fmi3SerializedFMUStateSize, AND(fmi3FMUState, size_t*))
NOT_SUPPORTED(fmi3SerializeFMUState, AND(fmi3FMUState, fmi3Byte[], size_t))
NOT_SUPPORTED(fmi3DeserializeFMUState, AND(const fmi3Byte[], size_t, fmi3FMUState*))
NOT_SUPPORTED(fmi3GetDirectionalDerivative, AND(const fmi3ValueReference[], size_t, const fmi3ValueReference[], size_t,
                                                const fmi3Float64[], size_t, fmi3Float64[], size_t))
NOT_SUPPORTED(fmi3GetAdjointDerivative, AND(const fmi3ValueReference[], size_t, const fmi3ValueReference[], size_t,
                                            const fmi3Float64[], size_t, fmi3Float64[], size_t))
NOT_SUPPORTED(fmi3EnterConfigurationMode, )
NOT_SUPPORTED(fmi3ExitConfigurationMode, )
NOT_SUPPORTED(fmi3GetIntervalDecimal, AND(const fmi3ValueReference[], size_t, fmi3Float64[], fmi3IntervalQualifier[]))
NOT_SUPPORTED(fmi3GetIntervalFraction,
              AND(const fmi3ValueReference[], size_t, fmi3UInt64[], fmi3UInt64[], fmi3IntervalQualifier[]))
NOT_SUPPORTED(fmi3GetShiftDecimal, AND(const fmi3ValueReference[], size_t, fmi3Float64[]))
NOT_SUPPORTED(fmi3GetShiftFraction, AND(const fmi3ValueReference[], size_t, fmi3UInt64[], fmi3UInt64[]))
NOT_SUPPORTED(fmi3SetIntervalDecimal, AND(const fmi3ValueReference[], size_t, const fmi3Float64[]))
NOT_SUPPORTED(fmi3SetIntervalFraction, AND(const fmi3ValueReference[], size_t, const fmi3UInt64[], const fmi3UInt64[]))
NOT_SUPPORTED(fmi3SetShiftDecimal, AND(const fmi3ValueReference[], size_t, const fmi3Float64[]))
NOT_SUPPORTED(fmi3SetShiftFraction, AND(const fmi3ValueReference[], size_t, const fmi3UInt64[], const fmi3UInt64[]))
NOT_SUPPORTED(fmi3EvaluateDiscreteStates, )
NOT_SUPPORTED(fmi3SetContinuousStates, AND(const fmi3Float64[], size_t))
NOT_SUPPORTED(fmi3GetContinuousStateDerivatives, AND(fmi3Float64[], size_t))
NOT_SUPPORTED(fmi3GetEventIndicators, AND(fmi3Float64[], size_t))
NOT_SUPPORTED(fmi3GetContinuousStates, AND(fmi3Float64[], size_t))
NOT_SUPPORTED(fmi3GetNominalsOfContinuousStates, AND(fmi3Float64[], size_t))
NOT_SUPPORTED(fmi3GetOutputDerivatives,
              AND(const fmi3ValueReference[], size_t, const fmi3Int32[], fmi3Float64[], size_t))
NOT_SUPPORTED(fmi3ActivateModelPartition, AND(fmi3ValueReference, fmi3Float64))
}
