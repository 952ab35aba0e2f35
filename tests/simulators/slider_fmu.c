/* A mass on a rail with friction, as an FMU for co-simulation in FMI 2 and in FMI 3; one explicit Euler step a call.
   With -DFILTER the force passes a filter whose state no variable shows; with -DKEEPS a reset forgets to undo it. */
#include <stddef.h>
#include <stdlib.h>
#include <stdbool.h>

typedef struct { double x, v, F, b, m, z; } Slider;

static void begin(Slider *s) { s->x = s->v = s->F = 0.0; s->b = 0.3; s->m = 2.0;
#ifndef KEEPS
  s->z = 0.0;
#endif
}
static double *place(Slider *s, unsigned r) {
  double *all[] = {NULL, &s->x, &s->v, &s->F, &s->b, &s->m};
  return r < 6 ? all[r] : NULL;
}
static int move(Slider *s, double h) {
  double F = s->F, x = s->x + h * s->v;
#if defined(FILTER) || defined(KEEPS)
  s->z += 0.5 * (F - s->z); F = s->z;
#endif
  s->v += h * (F - s->b * s->v) / s->m; s->x = x;
  return 0;
}
static int get(Slider *s, const unsigned *r, size_t n, double *out) {
  for (size_t k = 0; k < n; k++) { if (!place(s, r[k])) return 3; out[k] = *place(s, r[k]); } return 0;
}
static int set(Slider *s, const unsigned *r, size_t n, const double *in) {
  for (size_t k = 0; k < n; k++) { if (!place(s, r[k]) || (r[k] == 5 && in[k] <= 0)) return 3; *place(s, r[k]) = in[k]; }
  return 0;
}
static void *make(void) { Slider *s = calloc(1, sizeof *s); begin(s); return s; }

void *fmi2Instantiate(const char *a, int b, const char *c, const char *d, const void *e, int f, int g) { return make(); }
void fmi2FreeInstance(void *s) { free(s); }
int fmi2SetupExperiment(void *s, int a, double b, double c, int d, double e) { return 0; }
int fmi2EnterInitializationMode(void *s) { return 0; }
int fmi2ExitInitializationMode(void *s) { return 0; }
int fmi2Terminate(void *s) { return 0; }
int fmi2Reset(void *s) { begin(s); return 0; }
int fmi2GetReal(void *s, const unsigned *r, size_t n, double *v) { return get(s, r, n, v); }
int fmi2SetReal(void *s, const unsigned *r, size_t n, const double *v) { return set(s, r, n, v); }
int fmi2DoStep(void *s, double t, double h, int a) { return move(s, h); }

void *fmi3InstantiateCoSimulation(const char *a, const char *b, const char *c, bool d, bool e, bool f, bool g,
                                  const unsigned *h, size_t i, void *j, void *k, void *l) { return make(); }
void fmi3FreeInstance(void *s) { free(s); }
int fmi3EnterInitializationMode(void *s, bool a, double b, double c, bool d, double e) { return 0; }
int fmi3ExitInitializationMode(void *s) { return 0; }
int fmi3Terminate(void *s) { return 0; }
int fmi3Reset(void *s) { begin(s); return 0; }
int fmi3GetFloat64(void *s, const unsigned *r, size_t n, double *v, size_t k) { return get(s, r, n, v); }
int fmi3SetFloat64(void *s, const unsigned *r, size_t n, const double *v, size_t k) { return set(s, r, n, v); }
int fmi3DoStep(void *s, double t, double h, bool a, bool *event, bool *end, bool *early, double *last) {
  *event = *end = *early = false; *last = t + h; return move(s, h);
}
