$said
#ifndef ${PREFIX}_H
#define ${PREFIX}_H

#ifdef __cplusplus
extern "C" {
#endif

enum {
    ${PREFIX}_COORDINATES = $n,
    ${PREFIX}_PARAMETERS = $parameters,
    ${PREFIX}_INPUTS = $inputs
};

/* What a call came to: 0, or why the step was not taken. The state is that before it then. */
enum {
$outcomes
};

/* A trajectory: where it is, and what its steps remember. */
typedef struct {
    double workspace[$rows];
    double h;
    int set;
    int left;
} ${prefix}_state;

/* Begin at positions and momenta, or at positions and velocities. */
int ${prefix}_begin(double h, double t, ${prefix}_state *state, const double q[$n],
    const double p[$n], const double parameters[$sized]);
int ${prefix}_begin_moving(double h, double t, ${prefix}_state *state, const double q[$n],
    const double v[$n], const double parameters[$sized]);

/* Take the step from t to t + h. Inputs are those of this step; null where there are none.
 * Parameters are null where they are as before. Another h than before, or other parameters, cost
 * a few iterations more in this step. */
int ${prefix}_step(double h, double t, ${prefix}_state *state, const double *inputs,
    const double *parameters);

/* Return the energy, and give the velocities, where v is not null. */
double ${prefix}_energy(double t, ${prefix}_state *state, double v[$n]);

/* Give positions and momenta. */
void ${prefix}_get(const ${prefix}_state *state, double q[$n], double p[$n]);

#ifdef __cplusplus
}
#endif

#endif
