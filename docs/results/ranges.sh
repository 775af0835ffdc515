# The command line of every row of "The impedance range" in docs/results.md, and of the maps, as `cargo xtask
# figures` writes and runs them: each takes a quarter of a minute to minutes.

# the cases
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 200 --cutoff 20 --repeats 2 --pull 0.1,-0.1 --frictionless --ideal-drive --counts 8388608 --torque-limit 2 --svg docs/results/range-200hz.svg --force --progress range-200hz.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --pull 0.1 --frictionless --ideal-drive --counts 8388608 --torque-limit 2 --svg docs/results/range-1khz.svg --force --progress range-1khz.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 10000 --cutoff 200 --pull 0.3 --frictionless --ideal-drive --counts 8388608 --torque-limit 2 --svg docs/results/range-10khz.svg --force --progress range-10khz.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 20000 --cutoff 500 --pull 0.3 --frictionless --ideal-drive --counts 8388608 --torque-limit 2 --svg docs/results/range-20khz.svg --force --progress range-20khz.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 50000 --cutoff 1000 --pull 0.3 --frictionless --ideal-drive --counts 8388608 --torque-limit 2 --svg docs/results/range-50khz.svg --force --progress range-50khz.json

# washouts, measured
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --feed-forward all --washout 0.5 --pull 0.1 --frictionless --ideal-drive --counts 8388608 --torque-limit 2 --progress washout-0-5.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --feed-forward all --washout 2 --pull 0.1 --frictionless --ideal-drive --counts 8388608 --torque-limit 2 --progress washout-2.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --feed-forward all --washout 10 --pull 0.1 --frictionless --ideal-drive --counts 8388608 --torque-limit 2 --progress washout-10.json

# what the theory leaves out
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --frictionless --ideal-drive --counts 8388608 --pull 0.1 --torque-limit 2 --progress nothing.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --frictionless --ideal-drive --pull 0.1 --torque-limit 2 --progress encoder-steps.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --frictionless --counts 8388608 --pull 0.1 --torque-limit 2 --progress the-drive.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --frictionless --ideal-drive --counts 8388608 --pull 0.1 --torque-limit 0.02 --progress saturation-at-0-02-N-m.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --friction viscous --ideal-drive --counts 8388608 --pull 0.1 --torque-limit 2 --progress viscous-friction.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --friction coulomb --ideal-drive --counts 8388608 --pull 2 --torque-limit 2 --progress Coulomb-friction.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --frictionless --ideal-drive --counts 8388608 --grip --pull 0.1 --torque-limit 2 --progress a-hand.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --frictionless --ideal-drive --grip --pull 0.1 --torque-limit 2 --progress a-hand-and-encoder-steps.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --frictionless --ideal-drive --counts 100000 --grip --pull 0.1 --torque-limit 2 --progress a-hand-and-steps-a-fifth-as-long.json
haptic measure-range devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787 --rate 1000 --cutoff 20 --points 6 --repeats 2 --friction viscous --grip --pull 0.1 --torque-limit 2 --svg docs/results/range-1khz-world.svg --force --progress a-hand-encoder-steps-the-drive-and-viscous-friction.json

# the maps
haptic map devices/coupled-five-bar.toml --normal 1,0 --png docs/results/map-coupled-five-bar.png --force
haptic map devices/phantom-premium-1.5.toml --normal 1,1,0 --png docs/results/map-phantom-premium-1.5.png --force
