/* Take one step with one set of kernels. Return the status: 0 if the step succeeded. */
static int take(const kernels *kernels, double h, double t, double *W)
{
    //if explicit
    double kept[4 * $n];
    W[ACTIVE] = 1.0;
    W[COUNT] = 1.0;
    keep(W, POSITION, POSITION + 4 * $n, kept);
    kernels->call[ADVANCE](h, t, W);
    if (!all_finite(W, POSITION, POSITION + 4 * $n)) {
        put_back(W, POSITION, POSITION + 4 * $n, kept);
        W[STATUS] = NOT_FINITE;
    }
    //end explicit
    //if solved
    take_one(kernels, h, t, W);
    //end solved
    return (int)W[STATUS];
}

/* Parameter values of the declaration. */
static const double DEFAULTS[] = {$defaults};

/* Initialise a workspace, which may contain the state of another run. */
static int begin_at(double h, double t, ${prefix}_state *state, const double *q, const double *p,
    const double *v, const double *parameters)
{
    double *const W = state->workspace;
    for (int row = 0; row < ROWS; row++) {
        W[row] = 0.0;
    }
    for (int k = 0; k < $parameters; k++) {
        W[PARAMETER + k] = parameters ? parameters[k] : DEFAULTS[k];
    }
    for (int a = 0; a < $n; a++) {
        W[POSITION + a] = q[a];
        if (v) {
            W[VELOCITY + a] = v[a];
        } else {
            W[MOMENTUM + a] = p[a];
        }
    }
    state->h = h;
    state->set = 0;
    state->left = 0;
    begin(&SETS[0], v ? legendre : 0, h, t, W);
    energy(h, t, W);
    if (W[MASS_PIVOT] < 0.0 || h == 0.0 || h - h != 0.0 || !all_finite(W, POSITION, POSITION + $n)
            || !all_finite(W, MOMENTUM, MOMENTUM + $n) || !all_finite(W, VELOCITY, VELOCITY + $n)
            || !all_finite(W, PARAMETER, PARAMETER + $parameters)
            || !all_finite(W, ENERGY, ENERGY + 1)) {
        W[STATUS] = BAD_INPUT;
    }
    return (int)W[STATUS];
}

int ${prefix}_begin(double h, double t, ${prefix}_state *state, const double q[$n],
    const double p[$n], const double *parameters)
{
    return begin_at(h, t, state, q, p, 0, parameters);
}

int ${prefix}_begin_moving(double h, double t, ${prefix}_state *state, const double q[$n],
    const double v[$n], const double *parameters)
{
    return begin_at(h, t, state, q, 0, v, parameters);
}

/* Switch to another set of kernels. */
static void switch_to(int set, double h, double t, ${prefix}_state *state)
{
    const int anew = SETS[0].mode == STAGES && (set == 0 || state->set == 0);
    change_to(&SETS[set], anew, h, t, state->workspace);
    state->set = set;
    state->left = set > 0 ? STRETCH : 0;
}

int ${prefix}_step(double h, double t, ${prefix}_state *state, const double *inputs,
    const double *parameters)
{
    double *const W = state->workspace;
    int anew = h != state->h;
    for (int k = 0; parameters && k < $parameters; k++) {
        anew |= W[PARAMETER + k] != parameters[k];
        W[PARAMETER + k] = parameters[k];
    }
    //if inputs
    for (int k = 0; k < $inputs; k++) {
        for (int i = 0; i < INPUT_STRIDE; i++) {
            W[INPUT + k * INPUT_STRIDE + i] = inputs ? inputs[k] : 0.0;
        }
    }
    //end inputs
    //if free
    (void)inputs;
    //end free
    if (anew) {
        begin(&SETS[state->set], 0, h, t, W);
        state->h = h;
    }
    W[STATUS] = 0.0;
    while (take(&SETS[state->set], h, t, W) != 0) {
        if (state->set + 1 == NUMBER_OF_SETS$hopeless) {
            return (int)W[STATUS];
        }
        switch_to(state->set + 1, h, t, state);
    }
    if (state->left > 0 && --state->left == 0) {
        switch_to(0, h, t + h, state);
    }
    return 0;
}

double ${prefix}_energy(double t, ${prefix}_state *state, double *v)
{
    double *const W = state->workspace;
    energy(state->h, t, W);
    for (int a = 0; v && a < $n; a++) {
        v[a] = W[VELOCITY + a];
    }
    return W[ENERGY];
}

void ${prefix}_get(const ${prefix}_state *state, double q[$n], double p[$n])
{
    for (int a = 0; a < $n; a++) {
        q[a] = state->workspace[POSITION + a];
        p[a] = state->workspace[MOMENTUM + a];
    }
}
