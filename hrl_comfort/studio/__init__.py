"""Studio: a policy watched in the browser, in real time, beside a person who is driven by hand or by a motion."""
