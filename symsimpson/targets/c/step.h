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

/* Index of each value in its array. */
enum {
$places
};

$meanings
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

/* Begin at positions and momenta, or at positions and velocities. Parameters may be null: they are
 * then those of the declaration. BAD_INPUT where a number is not finite, h is 0, or the mass matrix
 * is not positive definite. */
int ${prefix}_begin(double h, double t, ${prefix}_state *state, const double q[$n],
    const double p[$n], const double *parameters);
int ${prefix}_begin_moving(double h, double t, ${prefix}_state *state, const double q[$n],
    const double v[$n], const double *parameters);

/* Take the step from t to t + h. Inputs may be null for zeros, parameters where they are those of
 * the step before. With another h, or other parameters, the step begins its iteration anew; both
 * are kept whether the step is taken or not. Some steps are looked at twice, which takes up to
 * $stack bytes of stack. */
int ${prefix}_step(double h, double t, ${prefix}_state *state, const double *inputs,
    const double *parameters);

/* Return the energy at t, and write velocities to v, where v is not null. */
double ${prefix}_energy(double t, ${prefix}_state *state, double *v);

/* Write positions and momenta to q and p. */
void ${prefix}_get(const ${prefix}_state *state, double q[$n], double p[$n]);

#ifdef __cplusplus
}
#endif

#endif
