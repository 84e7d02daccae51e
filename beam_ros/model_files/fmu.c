/* A linear state space as a functional mock-up unit, FMI 3.0: co-simulation and model exchange.

   x' = A x + B u,  y = C x + D u. In co-simulation the inputs are held over a step, and the step is exact: the
   exponential of [[A, B], [0, 0]] h gives both matrices of it. Numbers, names and sizes stand in model.h. */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

#define SIZE (N_STATES + N_INPUTS)

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#ifdef FMI3_FUNCTION_PREFIX
#define NAME(name) JOIN(FMI3_FUNCTION_PREFIX, fmi3##name)
#else
#define NAME(name) fmi3##name
#endif
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define STATUS EXPORT Status

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef void *Handle;
typedef uint32_t Reference;

/* Value references: the time, inputs, outputs, states, their derivatives. */
enum { TIME = 0, INPUT = 1, OUTPUT = INPUT + N_INPUTS, STATE = OUTPUT + N_OUTPUTS, SLOPE = STATE + N_STATES };
enum { END = SLOPE + N_STATES };

typedef struct {
    double time;
    double u[N_INPUTS];
    double x[N_STATES];
    double step;                     /* for which the exponential stands; 0: for none */
    double exponential[SIZE * SIZE];
} Unit;

static void slopes(const Unit *unit, double *result) {
    for (int i = 0; i < N_STATES; ++i) {
        double sum = 0.0;
        for (int k = 0; k < N_STATES; ++k) sum += A[i][k] * unit->x[k];
        for (int k = 0; k < N_INPUTS; ++k) sum += B[i][k] * unit->u[k];
        result[i] = sum;
    }
}

static double output(const Unit *unit, int j) {
    double sum = 0.0;
    for (int k = 0; k < N_STATES; ++k) sum += C[j][k] * unit->x[k];
    for (int k = 0; k < N_INPUTS; ++k) sum += D[j][k] * unit->u[k];
    return sum;
}

static void multiply(const double *left, const double *right, double *result) {
    for (int i = 0; i < SIZE; ++i)
        for (int j = 0; j < SIZE; ++j) {
            double sum = 0.0;
            for (int k = 0; k < SIZE; ++k) sum += left[i * SIZE + k] * right[k * SIZE + j];
            result[i * SIZE + j] = sum;
        }
}

/* Scaling and squaring: the norm is brought below 1/2, where 18 terms of Taylor's series are exact to rounding. */
static bool exponentiate(Unit *unit, double h) {
    static const int terms = 18;
    double *scaled = malloc(3 * SIZE * SIZE * sizeof(double));
    if (!scaled) return false;
    double *sum = scaled + SIZE * SIZE, *product = sum + SIZE * SIZE;
    double norm = 0.0;
    for (int i = 0; i < SIZE; ++i) {
        double row = 0.0;
        for (int k = 0; k < SIZE; ++k) {
            double value = i >= N_STATES ? 0.0 : h * (k < N_STATES ? A[i][k] : B[i][k - N_STATES]);
            scaled[i * SIZE + k] = value;
            row += fabs(value);
        }
        if (row > norm) norm = row;
    }
    int halvings = 0;
    for (; norm > 0.5; norm *= 0.5) ++halvings;
    for (int i = 0; i < SIZE * SIZE; ++i) scaled[i] = ldexp(scaled[i], -halvings);
    /* Horner: I + M (I + M/2 (I + M/3 ...)) */
    memset(sum, 0, SIZE * SIZE * sizeof(double));
    for (int i = 0; i < SIZE; ++i) sum[i * SIZE + i] = 1.0;
    for (int term = terms; term > 0; --term) {
        multiply(scaled, sum, product);
        for (int i = 0; i < SIZE * SIZE; ++i) sum[i] = product[i] / term;
        for (int i = 0; i < SIZE; ++i) sum[i * SIZE + i] += 1.0;
    }
    for (; halvings > 0; --halvings) {
        multiply(sum, sum, product);
        memcpy(sum, product, SIZE * SIZE * sizeof(double));
    }
    memcpy(unit->exponential, sum, SIZE * SIZE * sizeof(double));
    free(scaled);
    unit->step = h;
    return true;
}

static void reset(Unit *unit) { memset(unit, 0, sizeof(Unit)); }

static Handle instantiate(const char *token) {
    if (!token || strcmp(token, TOKEN)) return NULL;
    return calloc(1, sizeof(Unit));
}

EXPORT const char *NAME(GetVersion)(void) { return "3.0"; }

STATUS NAME(SetDebugLogging)(Handle h, bool on, size_t n, const char *const categories[]) {
    (void)h, (void)on, (void)n, (void)categories;
    return OK;
}

EXPORT Handle NAME(InstantiateModelExchange)(const char *name, const char *token, const char *path, bool visible,
                                             bool logging, void *environment, void *log) {
    (void)name, (void)path, (void)visible, (void)logging, (void)environment, (void)log;
    return instantiate(token);
}

EXPORT Handle NAME(InstantiateCoSimulation)(const char *name, const char *token, const char *path, bool visible,
                                            bool logging, bool events, bool early, const Reference required[],
                                            size_t n_required, void *environment, void *log, void *update) {
    (void)name, (void)path, (void)visible, (void)logging, (void)events, (void)early, (void)required;
    (void)n_required, (void)environment, (void)log, (void)update;
    return instantiate(token);
}

EXPORT Handle NAME(InstantiateScheduledExecution)(const char *name, const char *token, const char *path, bool visible,
                                                  bool logging, void *environment, void *log, void *clock, void *lock,
                                                  void *unlock) {
    (void)name, (void)token, (void)path, (void)visible, (void)logging, (void)environment, (void)log;
    (void)clock, (void)lock, (void)unlock;
    return NULL;
}

EXPORT void NAME(FreeInstance)(Handle h) { free(h); }

STATUS NAME(EnterInitializationMode)(Handle h, bool has_tolerance, double tolerance, double start, bool has_stop,
                                     double stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((Unit *)h)->time = start;
    return OK;
}

STATUS NAME(Reset)(Handle h) {
    reset(h);
    return OK;
}

STATUS NAME(GetFloat64)(Handle h, const Reference references[], size_t n, double values[], size_t n_values) {
    const Unit *unit = h;
    double slope[N_STATES];
    bool has_slopes = false;
    if (n != n_values) return ERROR;
    for (size_t k = 0; k < n; ++k) {
        Reference own = references[k];
        if (own >= END) return ERROR;
        if (own == TIME) {
            values[k] = unit->time;
        } else if (own < OUTPUT) {
            values[k] = unit->u[own - INPUT];
        } else if (own < STATE) {
            values[k] = output(unit, (int)(own - OUTPUT));
        } else if (own < SLOPE) {
            values[k] = unit->x[own - STATE];
        } else {
            if (!has_slopes) slopes(unit, slope);
            has_slopes = true;
            values[k] = slope[own - SLOPE];
        }
    }
    return OK;
}

STATUS NAME(SetFloat64)(Handle h, const Reference references[], size_t n, const double values[], size_t n_values) {
    Unit *unit = h;
    if (n != n_values) return ERROR;
    for (size_t k = 0; k < n; ++k) {
        Reference own = references[k];
        if (own >= INPUT && own < OUTPUT) {
            unit->u[own - INPUT] = values[k];
        } else if (own >= STATE && own < SLOPE) {
            unit->x[own - STATE] = values[k];
        } else {
            return ERROR;
        }
    }
    return OK;
}

STATUS NAME(DoStep)(Handle h, double now, double step, bool no_return, bool *event, bool *terminate, bool *early,
                    double *last) {
    Unit *unit = h;
    double next[N_STATES];
    (void)no_return;
    *event = *terminate = *early = false;
    if (!(step >= 0.0) || !isfinite(step)) return ERROR;
    if (step > 0.0) {
        if (step != unit->step && !exponentiate(unit, step)) return ERROR;
        for (int i = 0; i < N_STATES; ++i) {
            const double *row = unit->exponential + i * SIZE;
            double sum = 0.0;
            for (int k = 0; k < N_STATES; ++k) sum += row[k] * unit->x[k];
            for (int k = 0; k < N_INPUTS; ++k) sum += row[N_STATES + k] * unit->u[k];
            next[i] = sum;
        }
        memcpy(unit->x, next, sizeof(next));
    }
    *last = unit->time = now + step;
    return OK;
}

STATUS NAME(SetTime)(Handle h, double time) {
    ((Unit *)h)->time = time;
    return OK;
}

STATUS NAME(SetContinuousStates)(Handle h, const double states[], size_t n) {
    if (n != N_STATES) return ERROR;
    memcpy(((Unit *)h)->x, states, sizeof(((Unit *)h)->x));
    return OK;
}

STATUS NAME(GetContinuousStates)(Handle h, double states[], size_t n) {
    if (n != N_STATES) return ERROR;
    memcpy(states, ((Unit *)h)->x, sizeof(((Unit *)h)->x));
    return OK;
}

STATUS NAME(GetContinuousStateDerivatives)(Handle h, double derivatives[], size_t n) {
    if (n != N_STATES) return ERROR;
    slopes(h, derivatives);
    return OK;
}

STATUS NAME(GetNominalsOfContinuousStates)(Handle h, double nominals[], size_t n) {
    (void)h;
    for (size_t k = 0; k < n; ++k) nominals[k] = 1.0;
    return OK;
}

STATUS NAME(GetNumberOfContinuousStates)(Handle h, size_t *n) {
    (void)h;
    *n = N_STATES;
    return OK;
}

STATUS NAME(GetNumberOfEventIndicators)(Handle h, size_t *n) {
    (void)h;
    *n = 0;
    return OK;
}

STATUS NAME(GetEventIndicators)(Handle h, double indicators[], size_t n) {
    (void)h, (void)indicators;
    return n ? ERROR : OK;
}

STATUS NAME(CompletedIntegratorStep)(Handle h, bool no_return, bool *event, bool *terminate) {
    (void)h, (void)no_return;
    *event = *terminate = false;
    return OK;
}

STATUS NAME(UpdateDiscreteStates)(Handle h, bool *again, bool *terminate, bool *nominals, bool *values, bool *has_next,
                                  double *next) {
    (void)h;
    *again = *terminate = *nominals = *values = *has_next = false;
    *next = 0.0;
    return OK;
}

STATUS NAME(GetFMUState)(Handle h, Handle *state) {
    if (!*state) *state = malloc(sizeof(Unit));
    if (!*state) return ERROR;
    memcpy(*state, h, sizeof(Unit));
    return OK;
}

STATUS NAME(SetFMUState)(Handle h, Handle state) {
    memcpy(h, state, sizeof(Unit));
    return OK;
}

STATUS NAME(FreeFMUState)(Handle h, Handle *state) {
    (void)h;
    free(*state);
    *state = NULL;
    return OK;
}

/* Changes of mode have nothing to do here. */
#define NOTHING_TO_DO(name) \
    STATUS NAME(name)(Handle h) { (void)h; return OK; }
NOTHING_TO_DO(ExitInitializationMode)
NOTHING_TO_DO(EnterEventMode)
NOTHING_TO_DO(EnterContinuousTimeMode)
NOTHING_TO_DO(EnterStepMode)
NOTHING_TO_DO(Terminate)
NOTHING_TO_DO(EvaluateDiscreteStates)
NOTHING_TO_DO(EnterConfigurationMode)
NOTHING_TO_DO(ExitConfigurationMode)

/* Every function of the standard is there; the model has no variables of these kinds. */
#define NOT_OF_THIS_MODEL(name) \
    STATUS NAME(name)(void) { return ERROR; }
#define NO_SUCH_VARIABLES(type) NOT_OF_THIS_MODEL(Get##type) NOT_OF_THIS_MODEL(Set##type)
NO_SUCH_VARIABLES(Float32)
NO_SUCH_VARIABLES(Int8)
NO_SUCH_VARIABLES(UInt8)
NO_SUCH_VARIABLES(Int16)
NO_SUCH_VARIABLES(UInt16)
NO_SUCH_VARIABLES(Int32)
NO_SUCH_VARIABLES(UInt32)
NO_SUCH_VARIABLES(Int64)
NO_SUCH_VARIABLES(UInt64)
NO_SUCH_VARIABLES(Boolean)
NO_SUCH_VARIABLES(String)
NO_SUCH_VARIABLES(Binary)
NO_SUCH_VARIABLES(Clock)
NO_SUCH_VARIABLES(IntervalDecimal)
NO_SUCH_VARIABLES(IntervalFraction)
NO_SUCH_VARIABLES(ShiftDecimal)
NO_SUCH_VARIABLES(ShiftFraction)
NOT_OF_THIS_MODEL(GetNumberOfVariableDependencies)
NOT_OF_THIS_MODEL(GetVariableDependencies)
NOT_OF_THIS_MODEL(SerializedFMUStateSize)
NOT_OF_THIS_MODEL(SerializeFMUState)
NOT_OF_THIS_MODEL(DeserializeFMUState)
NOT_OF_THIS_MODEL(GetDirectionalDerivative)
NOT_OF_THIS_MODEL(GetAdjointDerivative)
NOT_OF_THIS_MODEL(GetOutputDerivatives)
NOT_OF_THIS_MODEL(ActivateModelPartition)
