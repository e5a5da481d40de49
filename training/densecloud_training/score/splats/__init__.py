"""Do denser seeds help 3D Gaussian splatting? A small reference of the method (Kerbl et al. 2023) on the CPU, over
scenes whose truth is known.

    surface     a coloured mesh on coloured ground: the scene, and points of it as structure from motion finds them
    view        cameras, and photographs of a surface by them
    colmap      COLMAP's binary models: points in and out, cameras, images
    composite   Gaussians on a picture: which pixels each reaches, and what comes of them, front to back
    gaussians   Gaussians in space: from seeds, and as a camera sees them
    fit         the optimisation: loss, rates, densification, and how good unseen views become
    experiment  scenes x seeds x ways to make the seeds denser, and the table
"""
