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

/* The index of each value in its array. */
enum {
$places
};

$meanings
enum {
$outcomes
};

/* The complete state of one trajectory, including the values that its steps reuse. */
typedef struct {
    double workspace[$rows];
    double h;
    int set;
    int left;
} ${prefix}_state;

/* Start a trajectory from positions and momenta, or from positions and velocities. If parameters is
 * null, the values of the declaration apply. Return BAD_INPUT if a number is not finite, h is 0, or
 * the mass matrix is not positive definite. */
int ${prefix}_begin(double h, double t, ${prefix}_state *state, const double q[$n],
    const double p[$n], const double *parameters);
int ${prefix}_begin_moving(double h, double t, ${prefix}_state *state, const double q[$n],
    const double v[$n], const double *parameters);

/* Take the step from t to t + h. If inputs is null, all inputs are 0. If parameters is null, the
 * parameters of the previous step apply. If h or the parameters change, the step restarts its
 * iteration. The new values stay, even if the step fails. Some steps are verified by a second
 * solution, which takes up to $stack bytes of stack. */
int ${prefix}_step(double h, double t, ${prefix}_state *state, const double *inputs,
    const double *parameters);

/* Return the energy at t. If v is not null, write the velocities to v. */
double ${prefix}_energy(double t, ${prefix}_state *state, double *v);

/* Write the positions and momenta to q and p. */
void ${prefix}_get(const ${prefix}_state *state, double q[$n], double p[$n]);

#ifdef __cplusplus
}
#endif

#endif
